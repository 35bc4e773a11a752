"""The width of a band of new readings, against refits without each block and against unseen data of known models."""

from __future__ import annotations

import closed_form
import numpy as np
import pytest

from aero_bayes.estimate import Normal
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.intervals import BLOCK_COUNT, LinearisedFit, blocks_of_time, conformal_quantile
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.noise import residual_correlation_time
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH

PRIOR_SD, ROWS, NOISE = 50.0, 240, 0.1
SETTINGS = FitSettings(method="local", staged=False)


def design(force: np.ndarray) -> np.ndarray:
    """Two inputs that the model knows (n, 2): a force and its slow follower."""
    slow = np.zeros_like(force)
    for k in range(1, force.size):
        slow[k] = 0.9 * slow[k - 1] + 0.1 * force[k]
    return np.stack([force, slow], axis=-1)


def recording(rng: np.random.Generator, missing: float) -> tuple[np.ndarray, np.ndarray]:
    """A design (n, 2) and readings (n, 1): the model's, a term at large forces that it may lack, and white noise."""
    x = design(np.repeat(rng.uniform(-1.0, 1.0, ROWS // 12), 12))
    y = x @ [1.0, 2.0] + missing * np.maximum(np.abs(x[:, 0]) - 0.7, 0.0) + NOISE * rng.standard_normal(ROWS)
    return x, y[:, None]


def fitted(recordings: list[tuple[np.ndarray, np.ndarray]]) -> Fit:
    """The linear model fitted to recordings; the formula finds the design of each by its own stretch of time."""
    starts = [1000.0 * k for k in range(len(recordings))]
    by_start = {start: x for start, (x, _) in zip(starts, recordings, strict=True)}
    parameters = [closed_form.parameter(n, 0.5, -90.0, 90.0, Normal(0.0, PRIOR_SD)) for n in "ab"]
    experiments = [(start + 0.1 * np.arange(ROWS), y) for start, (_, y) in zip(starts, recordings, strict=True)]
    problem = closed_form.calibration(experiments, ["y"], parameters)

    def opened(asked):
        return closed_form.FormulaSimulator(
            asked, lambda time, p: (by_start[1000.0 * (time[0] // 1000.0)] @ p)[:, None]
        )

    return fit_calibration(problem, opened, SETTINGS)


def band(fit: Fit, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half-width in units of its factor of the readings of a new design."""
    covariance = fit.laplace.covariance[:2, :2]
    width = 180.0  # a linear parameter is searched in units of its range
    return x @ fit.values, np.sqrt(fit.noise["y"].sd ** 2 + np.einsum("nk,kl,nl->n", x, covariance, x) * width**2)


def ridge(x: np.ndarray, y: np.ndarray, sd: float) -> np.ndarray:
    return np.linalg.solve(x.T @ x / sd**2 + np.eye(x.shape[1]) / PRIOR_SD**2, x.T @ y / sd**2)


@pytest.mark.parametrize("count", [1, 3])
def test_the_factor_is_the_quantile_of_errors_of_refits_without_each_part(count: int) -> None:
    rng = np.random.default_rng(5)
    recordings = [recording(rng, 4.0) for _ in range(count)]
    found = fitted(recordings)
    x, y = (np.concatenate(part) for part in zip(*recordings, strict=True))
    sd, y = found.noise["y"].sd, y[:, 0]
    memory = [residual_correlation_time([r]) for r in np.split(y - x @ found.values, count)]
    linear = LinearisedFit(x.T / sd * 180.0, np.zeros(len(x)), np.eye(2) * (180.0 / PRIOR_SD) ** 2)
    blocks = blocks_of_time(found.series, linear.leverage, BLOCK_COUNT, int(np.ceil(2.0 * sum(memory))))
    parts = blocks[0] if count == 1 else np.split(np.arange(y.size), count)
    errors = np.empty(y.size)
    for part in parts:
        rest = np.setdiff1d(np.arange(y.size), part)
        errors[part] = y[part] - x[part] @ ridge(x[rest], y[rest], sd)
    scores = np.abs(errors) / band(found, x)[1]
    independent = scores.size / residual_correlation_time(np.split(scores, count))
    expected = np.quantile(scores, min(0.9 * (1.0 + 1.0 / independent), 1.0))
    assert expected > NORMAL_HALF_WIDTH
    assert found.predictor.band_factors == pytest.approx([expected], rel=1e-4)


@pytest.mark.parametrize(("missing", "count", "widest"), [(0.0, 1, 1.05), (0.0, 3, 1.03), (4.0, 1, 2.0), (4.0, 3, 2.0)])
def test_nine_tenths_of_unseen_readings_lie_in_the_bands(missing: float, count: int, widest: float) -> None:
    """Over 60 fits; the share varies by less than 0.1 from fit to fit, so that 0.055 is four standard errors."""
    shares, factors, fitted_shares = [], [], []
    for seed in range(60):
        rng = np.random.default_rng([17, seed])
        recordings = [recording(rng, missing) for _ in range(count)]
        found = fitted(recordings)
        (factor,) = found.predictor.band_factors
        x, y = recording(rng, missing)
        centre, sd = band(found, x)
        shares.append(np.mean(np.abs(y[:, 0] - centre) <= factor * sd))
        factors.append(factor / NORMAL_HALF_WIDTH)
        left = [(np.abs(y[:, 0] - band(found, x)[0]), band(found, x)[1]) for x, y in recordings]
        fitted_shares.append(np.mean([np.mean(r <= factor * sd) for r, sd in left]))
    assert np.std(shares) < 0.1
    assert np.mean(shares) == pytest.approx(0.9, abs=0.055)
    assert 1.0 <= np.mean(factors) < widest
    assert np.min(fitted_shares) >= 0.9 - 1e-9  # never narrower than what is left on the fitted readings


def test_nine_independent_scores_give_the_largest_as_exact_conformal_bound() -> None:
    """A tenth score of the same kind exceeds the largest of nine with probability 1/10: 20,000 draws, 5 sd."""
    rng = np.random.default_rng(3)
    above = [rng.exponential() > conformal_quantile([rng.exponential(size=9)], 0.9) for _ in range(20_000)]
    assert np.mean(above) == pytest.approx(0.1, abs=5.0 * np.sqrt(0.09 / 20_000))


def test_correlated_scores_count_for_fewer() -> None:
    scores = np.random.default_rng(4).exponential(size=200)
    once, often = conformal_quantile([scores], 0.9), conformal_quantile([np.repeat(scores, 20)], 0.9)
    assert once == pytest.approx(np.quantile(scores, 0.9 * (1.0 + 1.0 / 200)), rel=0.02)
    assert often == pytest.approx(once, rel=0.05)  # not the quantile of 4000 independent ones, but nearly of 200
    assert conformal_quantile([np.repeat(scores[:8], 20)], 0.9) == scores[:8].max()
