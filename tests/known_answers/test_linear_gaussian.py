"""A model that is linear in its parameters has a Gaussian posterior and an evidence in closed form.

With the noise's size unknown both are one integral over it, done here by quadrature over the closed form.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, NoiseModel, Normal
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.log_posterior import NoiseLayout
from aero_bayes.estimate.mcmc import run_chain
from aero_bayes.estimate.moves import WarpedStudentT
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.sampled_modes import importance_sample, pareto_smooth
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import ParameterTarget, SolverSettings
from aero_bayes.simulation.model import Model

TIME = np.linspace(0.0, 8.0, 201)
DESIGN = np.stack([np.ones(TIME.size), TIME, np.exp(-0.5 * TIME)], axis=1)
PRIOR_MEAN, PRIOR_SD = np.array([1.0, 0.0, 0.5]), np.array([1.0, 0.5, 2.0])
TRUTH, SIGMA = np.array([0.3, 0.4, -1.2]), 0.25
READINGS = DESIGN @ TRUTH + SIGMA * np.random.default_rng(11).standard_normal(TIME.size)


class Exact:
    """Posterior and evidence by quadrature over the logarithm of the noise's standard deviation."""

    def __init__(self, layout: NoiseLayout) -> None:
        self.log_sd = np.linspace(np.log(SIGMA) - 0.8, np.log(SIGMA) + 0.8, 801)
        prior = layout.log_prior(self.log_sd[:, None])
        log_joint, means, covariances = [], [], []
        for log_sd, log_prior in zip(self.log_sd, prior, strict=True):
            noise = np.exp(2.0 * log_sd)
            marginal = DESIGN * PRIOR_SD**2 @ DESIGN.T + noise * np.eye(TIME.size)
            density = multivariate_normal(DESIGN @ PRIOR_MEAN, marginal).logpdf(READINGS)
            covariance = np.linalg.inv(DESIGN.T @ DESIGN / noise + np.diag(PRIOR_SD**-2.0))
            means.append(covariance @ (DESIGN.T @ READINGS / noise + PRIOR_MEAN / PRIOR_SD**2))
            covariances.append(covariance)
            log_joint.append(density + log_prior)
        top = max(log_joint)
        weight = np.exp(np.array(log_joint) - top)
        step = self.log_sd[1] - self.log_sd[0]
        self.log_evidence = float(top + np.log(weight.sum() * step))
        self.weight = weight / weight.sum()
        means, covariances = np.array(means), np.array(covariances)
        self.mean = self.weight @ means
        spread = means - self.mean
        self.covariance = np.einsum("k,kij->ij", self.weight, covariances + spread[:, :, None] * spread[:, None, :])
        self.noise_mean = float(self.weight @ self.log_sd)
        self.noise_sd = float(np.sqrt(self.weight @ (self.log_sd - self.noise_mean) ** 2))


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory):
    source = Path(__file__).parent / "models" / "Straight.mo"
    model = Model.load(export_fmu("Straight", tmp_path_factory.mktemp("fmu") / "Straight.fmu", sources=[source]))
    items = tuple(
        Parameter(n, "1", 0.1, m - 10.0 * s, m + 10.0 * s, Normal(m, s), "linear", n, ParameterTarget(n))
        for n, m, s in zip("abc", PRIOR_MEAN, PRIOR_SD, strict=True)
    )
    calibration = calibrate(
        [Recording("line", TIME, {}, {"y": READINGS})], model, ParameterSet(items), noise=NoiseModel("white"),
        settings=CalibrationSettings(delay="none", solver=SolverSettings(1e-9, 1e-9)),
    )  # fmt: skip
    settings = FitSettings(method="local", staged=False)
    fit = fit_calibration(calibration, lambda p: open_simulator(p, workers=0), settings)
    with open_simulator(calibration.problem(), workers=0) as simulator:
        yield fit, simulator, Exact(NoiseLayout.of(calibration.data, fit.noise))


def natural(points: np.ndarray) -> np.ndarray:
    """From search coordinates, which are values over the width of their bounds."""
    return points * np.append(20.0 * PRIOR_SD, 1.0)


def test_laplace_is_the_closed_form(case, trust):
    fit, _, exact = case
    size = natural(np.ones(4))
    mean, covariance = natural(fit.laplace.mean), fit.laplace.covariance * np.outer(size, size)
    sd = np.sqrt(np.diag(exact.covariance))
    trust("laplace", np.max(np.abs(np.sqrt(np.diag(covariance))[:3] / sd - 1.0)))
    assert np.all(np.abs(mean[:3] - exact.mean) < 0.01 * sd)
    assert covariance[:3, :3] == pytest.approx(exact.covariance, rel=0.03, abs=0.03 * float(sd.min()) ** 2)
    assert abs(mean[3] - exact.noise_mean) < 0.2 * exact.noise_sd
    assert np.sqrt(covariance[3, 3]) == pytest.approx(exact.noise_sd, rel=0.05)


def test_importance_sampling_is_the_closed_form(case):
    fit, simulator, exact = case
    proposal = WarpedStudentT.of(fit.laplace.mean, fit.laplace.covariance, 8.0)
    found = importance_sample(fit.joint_target(simulator), proposal, 4000, np.random.default_rng(1))
    assert found.reliable
    assert found.log_evidence == pytest.approx(
        exact.log_evidence, abs=4.0 * np.sqrt(1.0 / found.ess - 1.0 / 4000) + 1e-3
    )


def test_sampler_is_the_closed_form(case, trust):
    fit, simulator, exact = case
    proposal = WarpedStudentT.of(fit.laplace.mean, fit.laplace.covariance, 8.0)
    chain = run_chain(fit.joint_target(simulator), proposal, SampleSettings(ess=1500.0, max_minutes=15.0), seed=2)
    assert chain.converged, chain.reason
    points = natural(chain.points.reshape(-1, 4))
    sd = np.append(np.sqrt(np.diag(exact.covariance)), exact.noise_sd)
    ess = np.array([d.ess_bulk for d in chain.diagnoses])
    assert np.all(np.abs(points.mean(axis=0) - np.append(exact.mean, exact.noise_mean)) < 4.5 * sd / np.sqrt(ess))
    trust("sampler", np.max(np.abs(points.std(axis=0) / sd - 1.0)))
    assert np.all(np.abs(points.std(axis=0) / sd - 1.0) < 4.5 / np.sqrt(ess))
    correlation = np.corrcoef(points[:, :3].T)
    expected = exact.covariance / np.outer(sd[:3], sd[:3])
    assert np.all(np.abs(correlation - expected) < 4.5 / np.sqrt(ess.min()))


@pytest.mark.parametrize("shape", [-0.3, 0.2, 0.5, 0.9])
def test_pareto_smoothing_finds_the_tail_it_was_given(shape):
    level = np.random.default_rng(4).random(40_000)
    weights = np.log1p(((1.0 - level) ** -shape - 1.0) / shape)
    smoothed, found = pareto_smooth(weights)
    assert found == pytest.approx(shape, abs=0.15)
    order = np.argsort(weights)
    assert np.all(np.diff(smoothed[order]) >= 0.0)
    assert smoothed.max() <= weights.max()
    body = order[: int(0.9 * weights.size)]
    assert np.array_equal(smoothed[body], weights[body])


def test_smoothed_weights_estimate_the_evidence_of_a_narrow_target():
    rng = np.random.default_rng(8)
    proposal = WarpedStudentT.of(np.zeros(2), np.eye(2), 8.0)

    def density(points):  # a Gaussian of covariance 0.25 whose integral is e^3
        return 3.0 - np.log(2.0 * np.pi * 0.25) - 2.0 * np.sum(points**2, axis=1)

    found = importance_sample(density, proposal, 6000, rng)
    assert found.log_evidence == pytest.approx(3.0, abs=4.5 / np.sqrt(found.ess))
    assert replace(found, pareto_k=0.9).reliable is False
