"""Fits and posteriors with process noise, against a filter and an optimiser of the tests' own.

The rig is an Ornstein-Uhlenbeck process: ``dx = theta (mu + u - x) dt + sigma dW``, read with white noise. Its
recordings are drawn from the exact distribution of one sample given the one before.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import Generator
from scipy.optimize import minimize

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.residual_tests import check_residuals

DRIFT = """model Drift
  parameter Real theta(unit = "1/s") = 5; parameter Real mu = 1;
  input Real u; output Real x(start = 0, fixed = true);
equation
  der(x) = theta * (mu + u - x);
end Drift;
"""
TRUTH = (10.0, 1.0, 1.0, 0.1)  # theta, mu, sigma, standard deviation of the readings
INTERVAL, COUNT = 0.02, 400
NAMES = ("theta", "mu", "process.x", "noise.x.sd_white")


def step(theta: float, sigma: float) -> tuple[float, float]:
    """Factor and variance of the state over one interval."""
    factor = math.exp(-theta * INTERVAL)
    return factor, sigma**2 * (1.0 - factor**2) / (2.0 * theta)


def drawn(rng: Generator) -> tuple[Recording, np.ndarray]:
    """A recording and its true state."""
    theta, mu, sigma, sd = TRUTH
    time = np.arange(COUNT) * INTERVAL
    u = np.floor(time) % 2
    (factor, variance), x = step(theta, sigma), np.zeros(COUNT)
    for k in range(1, COUNT):
        x[k] = factor * x[k - 1] + (1.0 - factor) * (mu + u[k - 1]) + math.sqrt(variance) * rng.standard_normal()
    return Recording("run", time, {"u": u}, {"x": x + sd * rng.standard_normal(COUNT)}), x


def log_likelihood(recording: Recording, theta: float, mu: float, sigma: float, sd: float) -> float:
    u, y = recording.inputs["u"], recording.outputs["x"]
    factor, variance = step(theta, sigma)
    x = p = total = 0.0
    for k in range(COUNT):
        if k:
            x, p = factor * x + (1.0 - factor) * (mu + u[k - 1]), factor**2 * p + variance
        s, away = p + sd**2, y[k] - x
        total -= 0.5 * (away**2 / s + math.log(2.0 * math.pi * s))
        x, p = x + p / s * away, p * sd**2 / s
    return total


def curvature(cost, at, width=0.01):
    """Second differences (k, k) of a cost."""
    steps = width * np.eye(len(at))

    def mixed(a, b):
        return cost(at + a + b) - cost(at + a - b) - cost(at - a + b) + cost(at - a - b)

    return np.array([[mixed(a, b) for b in steps] for a in steps]) / (4.0 * width**2)


def settings(**noise: object) -> aero_bayes.FitSettings:
    return aero_bayes.FitSettings(
        method="local",
        noise=NoiseModel(**({"process": {"x": "estimated"}} | noise)),
        calibration=CalibrationSettings(initial_states="reading", may_start_at_rest=()),
    )


def fitted(model, recording, **noise):
    bounds = {"theta": (0.1, 100.0), "mu": (0.01, 50.0)}
    return aero_bayes.fit(recording, model, parameters=bounds, settings=settings(**noise), workers=0)


@pytest.fixture(scope="module")
def model(exported):
    return exported(DRIFT)


@pytest.fixture(scope="module")
def case(model):
    recording, x = drawn(np.random.default_rng(3))
    return fitted(model, recording), recording, x


def test_fit_is_the_maximum_of_another_filters_likelihood(case):
    fit, recording, _ = case
    items = [fit.calibration.parameters[name] for name in NAMES]

    def cost(point):
        values = np.exp(point)
        prior = sum(float(p.prior.log_pdf(v)) + x for p, v, x in zip(items, values, point, strict=True))
        return -log_likelihood(recording, *values) - prior

    best = minimize(cost, np.log(TRUTH), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9, "maxiter": 4000})
    values = np.array([fit[name].value for name in NAMES])
    sd = np.sqrt(np.diag(np.linalg.inv(curvature(cost, best.x))))
    assert fit.log_likelihood == pytest.approx(log_likelihood(recording, *values), abs=1e-4)
    np.testing.assert_array_less(np.abs(np.log(values) - best.x), 0.03 * sd)
    found = [fit[name].sd / fit[name].value for name in NAMES]
    np.testing.assert_allclose(found, sd, rtol=0.35)  # expected information against observed


def test_innovations_and_smoothed_states_hold_what_they_promise(case):
    fit, _, x = case
    (report,) = check_residuals(fit.calibration, fit.series, fit.optimum, {("run", "x"): 0.1})
    assert report.verdict == "adequate"
    states = fit.states[0]
    inside = np.abs(x - states.mean[:, 0]) <= 1.645 * states.sd[:, 0]
    assert 0.75 < np.mean(inside) <= 1.0
    assert fit.warnings == ()
    assert fit.to_dict()["process_noise"]["x"]["value"] == fit["process.x"].value


def test_posterior_is_that_of_a_grid(model, case):
    _, recording, _ = case
    theta, mu, *_ = TRUTH
    known = replace(settings(), fixed={"theta": theta})
    fit = aero_bayes.fit(recording, model, parameters={"mu": (0.99999, 1.00001)}, settings=known, workers=0)
    posterior = aero_bayes.sample(fit, workers=0)
    items = [fit.calibration.parameters[name] for name in NAMES[2:]]
    sigma, sd = np.linspace(math.log(0.3), math.log(3.0), 61), np.linspace(math.log(0.01), math.log(0.3), 61)
    density = np.array([[log_likelihood(recording, theta, mu, math.exp(a), math.exp(b)) for b in sd] for a in sigma])
    for k, (item, axis) in enumerate(zip(items, (sigma, sd), strict=True)):
        prior = item.prior.log_pdf(np.exp(axis)) + axis
        density += prior[:, None] if k == 0 else prior
    weight = np.exp(density - density.max())
    weight /= weight.sum()
    for k, axis in enumerate((sigma, sd)):
        share = weight.sum(axis=1 - k)
        mean = float(share @ axis)
        spread = math.sqrt(float(share @ (axis - mean) ** 2))
        draws = np.log(posterior.samples(NAMES[2 + k]))
        assert draws.mean() == pytest.approx(mean, abs=0.15 * spread)
        assert draws.std() == pytest.approx(spread, rel=0.15)


def test_prediction_of_another_recording_spreads_as_the_process_does(model, case):
    fit, recording, _ = case
    posterior = aero_bayes.sample(fit, settings=aero_bayes.SampleSettings(max_steps=20), workers=0)
    time = np.arange(100) * INTERVAL
    band = posterior.predict({"time": time, "u": np.zeros(100)}).predictive
    theta, _, sigma, sd = (np.median(posterior.samples(name)) for name in NAMES)
    late = math.sqrt(sigma**2 / (2.0 * theta) + sd**2)
    assert float(band.upper[-1, 0] - band.lower[-1, 0]) == pytest.approx(2.0 * 1.645 * late, rel=0.1)
    inside = posterior.predictive[0]
    y = recording.outputs["x"]
    assert 0.85 < np.mean((inside.lower[:, 0] <= y) & (y <= inside.upper[:, 0])) < 0.95


def test_given_diffusion_is_kept_and_an_uncertain_start_is_the_models(model):
    recording, _ = drawn(np.random.default_rng(4))
    fit = fitted(model, recording, process={"x": 1.0}, initial_sd={"x": 0.5})
    assert "process.x" not in fit.calibration.parameters
    assert fit.calibration.process.diffusion == {"x": 1.0}
    assert "x" not in fit.calibration.data.experiments[0].start
    with pytest.raises(InputError, match="no state 'z'"):
        fitted(model, recording, process={"z": "estimated"})
    with pytest.raises(InputError, match="process noise"):
        aero_bayes.fit(
            recording, model, parameters=["mu"], workers=0,
            settings=aero_bayes.FitSettings(cost="weighted", noise=NoiseModel(process={"x": "estimated"})),
        )  # fmt: skip
