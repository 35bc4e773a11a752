"""Predictive criteria against closed forms of a linear model, and left-out recordings of a simulated rig."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import simulated_rigs.aero as bench
from aero_bayes.errors import InputError
from aero_bayes.estimate import CalibrationSettings, FitSettings, fit
from aero_bayes.modelica import export_fmu
from aero_bayes.posterior.comparison import leave_future_out, leave_one_out, waic
from aero_bayes.posterior.crossvalidation import (
    block_edges,
    block_log_likelihood,
    leave_one_recording_out,
    time_ordered_scores,
)
from aero_bayes.simulation import Model, open_simulator

BLOCKS, EACH = 12, 8
TIME = np.linspace(0.0, 4.0, BLOCKS * EACH)
DESIGN = np.stack([np.ones(TIME.size), np.cos(5.0 * TIME), np.sin(3.0 * TIME)], axis=1)
SD, PRIOR_SD = 0.5, 2.0
READINGS = DESIGN @ np.array([0.5, -0.3, 1.0]) + SD * np.random.default_rng(3).standard_normal(TIME.size)
MARGINAL = multivariate_normal(np.zeros(TIME.size), PRIOR_SD**2 * DESIGN @ DESIGN.T + SD**2 * np.eye(TIME.size))


def rows(*blocks: int) -> np.ndarray:
    return np.concatenate([np.arange(b * EACH, (b + 1) * EACH) for b in blocks]) if blocks else np.empty(0, dtype=int)


def log_marginal(index: np.ndarray) -> float:
    if index.size == 0:
        return 0.0
    return float(multivariate_normal(np.zeros(index.size), MARGINAL.cov[np.ix_(index, index)]).logpdf(READINGS[index]))


def log_posterior_predictive(block: int) -> float:
    """Log-density of a stretch averaged over the posterior that has seen everything, the stretch included."""
    covariance = np.linalg.inv(DESIGN.T @ DESIGN / SD**2 + np.eye(3) / PRIOR_SD**2)
    x, y = DESIGN[rows(block)], READINGS[rows(block)]
    mean = x @ (covariance @ DESIGN.T @ READINGS / SD**2)
    return float(multivariate_normal(mean, x @ covariance @ x.T + SD**2 * np.eye(EACH)).logpdf(y))


def posterior_densities(index: np.ndarray, draws: int = 4000, seed: int = 1) -> np.ndarray:
    """Log-densities of all stretches over exact draws of the posterior given the readings at ``index``."""
    x, y = DESIGN[index], READINGS[index]
    covariance = np.linalg.inv(x.T @ x / SD**2 + np.eye(3) / PRIOR_SD**2)
    theta = np.random.default_rng(seed).multivariate_normal(covariance @ x.T @ y / SD**2, covariance, draws)
    z = (READINGS - theta @ DESIGN.T) / SD
    density = -0.5 * z**2 - np.log(SD * np.sqrt(2.0 * np.pi))
    return density.reshape(draws, BLOCKS, EACH).sum(axis=2)


def test_leave_one_out_and_waic_are_the_closed_form():
    densities = posterior_densities(rows(*range(BLOCKS)))
    exact = [
        log_marginal(rows(*range(BLOCKS))) - log_marginal(rows(*(set(range(BLOCKS)) - {b}))) for b in range(BLOCKS)
    ]
    found = leave_one_out(densities)
    assert found.reliable
    assert found.pointwise == pytest.approx(exact, abs=0.08)
    assert waic(densities).elpd == pytest.approx(sum(exact), abs=0.5)
    seen = [log_posterior_predictive(b) for b in range(BLOCKS)]
    assert found.parameters == pytest.approx(sum(seen) - sum(exact), abs=0.3)


def test_leave_future_out_is_the_evidence_of_what_follows():
    first = 2
    exact = [log_marginal(rows(*range(b + 1))) - log_marginal(rows(*range(b))) for b in range(first, BLOCKS)]
    asked = []

    def refit(known: int) -> np.ndarray:
        asked.append(known)
        return posterior_densities(rows(*range(known)), seed=known)

    found = leave_future_out(posterior_densities(rows(*range(BLOCKS))), first, refit)
    assert found.refits == len(asked)
    assert found.pointwise == pytest.approx(exact, abs=0.25)
    assert found.elpd == pytest.approx(log_marginal(rows(*range(BLOCKS))) - log_marginal(rows(*range(first))), abs=0.3)
    with pytest.raises(InputError, match="nothing to predict"):
        leave_future_out(posterior_densities(rows(0)), BLOCKS)


@pytest.fixture(scope="module")
def two_recordings(tmp_path_factory: pytest.TempPathFactory):
    model = Model.load(export_fmu("Aero.Systems.OneDof", tmp_path_factory.mktemp("fmu") / "OneDof.fmu"))
    rng = np.random.default_rng(2)
    recordings = [
        bench.simulate_recording(
            bench.Truth("one_dof", bench.Parameters(), (), delay), bench.random_levels(rng, 18.0, 10.0),
            bench.white(1.0), rng, duration=10.0, rate_hz=50.0, name=name,
        )
        for name, delay in (("first", 0.004), ("second", 0.011))
    ]  # fmt: skip
    settings = FitSettings(method="local", calibration=CalibrationSettings(delay="free", may_start_at_rest=("theta",)))
    return fit(recordings, model, settings=settings, workers=0)


def opened(problem):
    return open_simulator(problem, workers=0)


def test_stretches_add_up_to_the_likelihood(two_recordings):
    fitted = two_recordings
    with opened(fitted.calibration.problem()) as simulator:
        joint = fitted.joint_target(simulator)
        blocks = block_log_likelihood(joint, fitted.laplace.mean[None], block_edges(joint, 6))
    together = np.concatenate(list(blocks), axis=1)
    assert together.shape == (1, 12)
    assert together.sum() == pytest.approx(fitted.log_likelihood, rel=1e-6)


def test_a_left_out_recording_is_predicted_to_the_noise(two_recordings):
    left_out = leave_one_recording_out(two_recordings, opened, np.random.default_rng(1), draws=12)
    assert [item.recording for item in left_out] == ["first", "second"]
    for item in left_out:
        for output, fitted in item.rms_fitted.items():
            assert fitted * 0.999 < item.rms[output] < 1.15 * fitted
    total = sum(item.elpd for item in left_out)
    assert two_recordings.log_likelihood - 80.0 < total < two_recordings.log_likelihood


def test_criteria_in_time_order_agree_on_a_right_model(two_recordings):
    found = time_ordered_scores(two_recordings, opened, np.random.default_rng(4), blocks=6, first=3, draws=200)
    assert found.leave_one_out.elpd == pytest.approx(found.waic.elpd, abs=6.0)
    assert found.leave_one_out.pointwise.size == 12
    assert found.leave_future_out.pointwise.size == 3
    share = two_recordings.log_likelihood / 2.0
    assert found.leave_future_out.elpd == pytest.approx(share, abs=0.1 * abs(share))


def test_one_recording_cannot_be_left_out(two_recordings, tmp_path: Path):
    model = two_recordings.calibration.model
    alone = fit(two_recordings.calibration.data.recordings[0], model, settings=FitSettings(method="local"), workers=0)
    with pytest.raises(InputError, match="at least two"):
        leave_one_recording_out(alone, opened, np.random.default_rng(1))
