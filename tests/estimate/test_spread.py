"""Covariances by the moving-block jackknife against closed forms, refits and Monte Carlo."""

from __future__ import annotations

from collections.abc import Callable

import closed_form
import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm, t

from aero_bayes.estimate import NoiseModel, Normal
from aero_bayes.estimate.intervals import curvature_adjustment, jackknife_covariance, widened_covariance
from aero_bayes.estimate.levenberg_marquardt import LocalSettings
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.log_posterior import CurvatureAdjustment
from aero_bayes.estimate.noise import OutputNoise, SampleTimes
from aero_bayes.estimate.objective import Objective, Series

EXACT = LocalFitSettings(LocalSettings(tolerance=1e-9), hold_noise=True, prior=False)
HELD = OutputNoise(1.0, model_error=True)


def autoregression(rng: np.random.Generator, rho: float, n: int) -> np.ndarray:
    """An autoregression of order one with unit variance."""
    shocks = np.sqrt(1.0 - rho**2) * rng.standard_normal(n + 400)
    return lfilter([1.0], [1.0, -rho], shocks)[400:]


def series(recording: int, n: int) -> Series:
    time = np.arange(n, dtype=float)
    return Series(recording, 0, "y", SampleTimes.of(time, time), np.zeros(n))


def regression(recordings: list[Series], x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of y (n,) on x (n, k), and the covariance of the coefficients that the jackknife gives."""
    root = np.linalg.cholesky(np.linalg.inv(x.T @ x))
    found = np.linalg.lstsq(x, y, rcond=None)[0]
    return found, root @ jackknife_covariance(recordings, root.T @ x.T, y - x @ found) @ root.T


def test_whole_recordings_are_left_out_as_in_refits():
    """With twelve recordings the covariance is that of twelve refits, scaled to the quantile of Student's t."""
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal((12 * 30, 3)), rng.standard_normal(12 * 30)
    found, covariance = regression([series(e, 30) for e in range(12)], x, y)
    owner = np.repeat(np.arange(12), 30)
    refits = [np.linalg.lstsq(x[owner != e], y[owner != e], rcond=None)[0] - found for e in range(12)]
    exact = (11.0 / 12.0) * sum(np.outer(d, d) for d in refits)
    assert covariance == pytest.approx(exact * (t.ppf(0.95, 11) / norm.ppf(0.95)) ** 2, rel=1e-9)


def test_intervals_hold_where_regressors_and_errors_are_autoregressions():
    """Long-run covariances are known: (1 + a b) / (1 - a b) times that of independent errors.

    400 recordings with four slopes each, nearly independent: the share that holds is uncertain by 0.0075 at 90 % and
    by 0.0125 at 50 %. The intervals are those of t at 90 %, and a little wide at 50 %: 0.55 for 0.5.
    """
    rng, n, a, b = np.random.default_rng(2), 1500, 0.8, 0.9
    truth, held_90, held_50, variances = np.array([1.0, -2.0, 0.5, 0.0]), [], [], []
    for _ in range(400):
        x = np.column_stack([autoregression(rng, a, n) for _ in truth])
        found, covariance = regression([series(0, n)], x, x @ truth + autoregression(rng, b, n))
        z = np.abs(found - truth) / np.sqrt(np.diag(covariance))
        held_90.append(z < norm.ppf(0.95))
        held_50.append(z < norm.ppf(0.75))
        variances.append(np.diag(covariance))
    assert np.mean(held_90) == pytest.approx(0.9, abs=4.0 * 0.0075 + 0.01)
    assert np.mean(held_50) == pytest.approx(0.55, abs=4.0 * 0.0125 + 0.02)
    exact = (1.0 + a * b) / (1.0 - a * b) / n * (t.ppf(0.95, 9) / norm.ppf(0.95)) ** 2
    assert np.mean(variances) == pytest.approx(exact, rel=0.2)


def test_correlated_errors_of_two_outputs_are_not_counted_twice():
    """Two outputs with the same error tell no more than one: the variance is twice that of independent outputs."""
    rng, n, ratios = np.random.default_rng(3), 1200, []
    for _ in range(200):
        x, error = rng.standard_normal(n), rng.standard_normal(n)
        both = [np.concatenate([x, x])[:, None], np.concatenate([error, error])]
        ratios.append(regression([series(0, n), series(0, n)], *both)[1][0, 0] * 2 * n)
    widening = (t.ppf(0.95, 9) / norm.ppf(0.95)) ** 2
    # The mean of 200 variances of nine degrees of freedom each is uncertain by 3 %.
    assert np.mean(ratios) / widening == pytest.approx(2.0, rel=0.2)


N = 1500
TIME = np.linspace(0.0, 1.0, N)


def line(time: np.ndarray, v: np.ndarray) -> np.ndarray:
    return (v[0] + v[1] * time)[:, None]


def bump(time: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A line over the second half and, before it, a constant that belongs to the recording."""
    late = time > 0.5
    return np.where(late, v[0] + v[1] * time, v[2])[:, None]


def fitted(
    y: np.ndarray, noise: OutputNoise, formula: Callable[[np.ndarray, np.ndarray], np.ndarray] = line, own: str = ""
) -> tuple[Objective, Optimum]:
    items = [closed_form.parameter(n, 0.0, -10.0, 10.0, Normal(0.0, 3.0)) for n in "ab"]
    items += [closed_form.parameter(n, 0.0, -10.0, 10.0, Normal(0.0, 3.0), recording=0) for n in own]
    problem = closed_form.calibration([(TIME, y[:, None])], ["y"], items)
    objective = Objective(problem, closed_form.FormulaSimulator(problem.problem(), formula))
    free = tuple(range(len(items)))
    return objective, local_fit(objective, np.zeros(len(items)), free, noise={"y": noise}, settings=EXACT)


def test_a_white_residual_is_never_given_less_than_independent_readings():
    rng = np.random.default_rng(4)
    design = np.stack([np.ones(N), TIME], axis=1)
    white = np.sqrt(np.diag(np.linalg.inv(design.T @ design))) / 20.0
    for _ in range(20):
        objective, found = fitted(1.0 - 0.5 * TIME + rng.standard_normal(N), HELD)
        predicted = np.sqrt(np.diag(widened_covariance(objective, found)))
        assert np.all(predicted > 0.99 * white)
        assert np.all(predicted < 3.0 * white)


def test_noise_that_describes_its_residual_needs_no_adjustment():
    objective, found = fitted(autoregression(np.random.default_rng(5), 0.9, N), OutputNoise(0.3, 1.0, 0.006))
    assert curvature_adjustment(objective, found) is None


def test_a_recordings_own_parameter_is_not_left_out():
    """One that only the first half sees leaves the line as it is, and is less certain by the line's median factor."""
    y = 1.0 - 0.5 * TIME + 0.3 * autoregression(np.random.default_rng(6), 0.98, N)
    objective, found = fitted(y, HELD, bump, own="c")
    spread = curvature_adjustment(objective, found)
    assert spread is not None
    information = found.whitened.slopes @ found.whitened.slopes.T
    wide = np.linalg.inv(spread.map.T @ information @ spread.map)
    narrow = np.linalg.inv(information)
    root = np.linalg.inv(np.linalg.cholesky(narrow[:2, :2]))
    factors = np.linalg.eigvalsh(root @ wide[:2, :2] @ root.T)
    assert np.all(factors > 1.0 - 1e-9)
    assert factors.max() > 2.0
    assert wide[2, 2] / narrow[2, 2] == pytest.approx(np.median(factors), rel=1e-6)
    assert wide[2, :2] == pytest.approx(0.0, abs=1e-9 * wide[2, 2])


def test_the_loops_intervals_are_those_of_a_fit():
    """The closed loop takes its intervals from the optimum of a search, ``fit`` from its own approximation."""
    rng = np.random.default_rng(7)
    y = 1.0 - 0.5 * TIME + 0.2 * np.sin(40.0 * TIME**2) + 0.01 * rng.standard_normal(N)
    items = [closed_form.parameter(n, 0.0, -10.0, 10.0, Normal(0.0, 3.0)) for n in "ab"]
    problem = closed_form.calibration([(TIME, y[:, None])], ["y"], items, NoiseModel("auto"))
    found = closed_form.fitted(line, problem)
    assert found.noise["y"].model_error
    assert found.widening is not None
    assert found.laplace.covariance == pytest.approx(found.optimum.covariance, rel=1e-6)


def test_the_map_only_contracts():
    """In units of the prior it is symmetric and its eigenvalues are at most one, where the data say little too."""
    rng = np.random.default_rng(4)
    prior_sd = np.array([3.0, 1e-3]) / 20.0
    items = [
        closed_form.parameter(n, 0.0, -10.0, 10.0, Normal(0.0, 20.0 * sd)) for n, sd in zip("ab", prior_sd, strict=True)
    ]
    y = 1.0 - 0.5 * TIME + autoregression(rng, 0.9, N)
    problem = closed_form.calibration([(TIME, y[:, None])], ["y"], items)
    objective = Objective(problem, closed_form.FormulaSimulator(problem.problem(), line))
    found = local_fit(objective, np.zeros(2), (0, 1), noise={"y": HELD}, settings=EXACT)
    spread = curvature_adjustment(objective, found)
    assert spread is not None
    unit = objective.parameters.prior_sd()
    scaled = spread.map * unit / unit[:, None]
    np.testing.assert_allclose(scaled, scaled.T, atol=1e-9)
    values = np.linalg.eigvalsh(scaled)
    assert np.all((values > 0.0) & (values < 1.0 + 1e-9))
    assert values[0] < 0.5


def test_a_widened_likelihood_keeps_its_slope_at_the_fit():
    """So the posterior has its mode where the fit has it: the slope of the prior there is balanced."""
    prior, shrunk, centre = np.array([3.0, -1.0]), np.array([[0.3, 0.1], [0.1, 0.6]]), np.array([0.2, 0.5])
    wide = CurvatureAdjustment(centre, shrunk, prior)

    def log_likelihood(x):
        off = wide(x[None])[0] - centre
        return float(-prior @ off - 0.5 * off @ off) + float(wide.added(x[None])[0])

    step = 1e-6 * np.eye(2)
    slope = [(log_likelihood(centre + s) - log_likelihood(centre - s)) / 2e-6 for s in step]
    assert slope == pytest.approx(-prior, abs=1e-6)
