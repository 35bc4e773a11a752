"""The likelihood of white plus Ornstein-Uhlenbeck noise against the dense multivariate normal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aero_bayes.simulation.interface import (
    Experiment,
    ParameterTarget,
    Problem,
    SolverSettings,
    StartTarget,
    gauss_newton_products,
)
from aero_bayes.simulation.native_simulator import NativeSimulator

pytestmark = pytest.mark.fast

GRIDS = {
    "uniform": np.linspace(0.0, 3.0, 121),
    "irregular": np.sort(np.random.default_rng(2).uniform(0.0, 3.0, 80)),
    "rounded": np.round(np.linspace(0.0, 3.0, 91), 3),
    "two samples": np.array([0.0, 0.1]),
}
NOISES = [(0.1, 0.0, 0.0), (0.1, 0.3, 0.05), (0.0, 0.3, 0.02), (0.2, 0.05, 5.0), (0.1, 0.1, 1e-9), (0.1, 0.2, 0.0)]


def covariance(time: np.ndarray, noise: tuple[float, float, float]) -> np.ndarray:
    white, sd, tau = noise
    lag = np.abs(time[:, None] - time)
    coloured = np.exp(-lag / tau) if tau > 0.0 else np.eye(time.size)
    return white**2 * np.eye(time.size) + sd**2 * coloured


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("gaps", [False, True])
def test_likelihood_and_products(test_fmu, here, grid, noise, gaps):
    time = GRIDS[grid]
    rng = np.random.default_rng(7)
    measured = np.exp(-1.3 * time)[:, None] * np.array([1.0, 2.0]) + 0.2 * rng.standard_normal((time.size, 2))
    if gaps:
        measured[rng.uniform(size=measured.shape) < 0.3] = np.nan
        measured[time.size // 2 : time.size // 2 + 5, 0] = np.nan
    experiment = Experiment(time, ("x", "y"), measured=measured)
    targets = (ParameterTarget("k"), StartTarget("x"), ParameterTarget("c"))
    problem = Problem(test_fmu("Dahlquist"), (experiment,), (targets,), settings=SolverSettings(1e-10, 1e-10))
    values = np.array([[1.1, 1.2, 0.05]])
    noises = np.array([[noise, (0.3, 0.1, 0.2)]])
    with NativeSimulator(problem, pool=here) as simulator:
        likelihood = simulator.log_likelihood(values, noises).log_likelihood[0, 0]
        gn = simulator.gauss_newton(values, noises, active=[0, 1, 2])
        run = simulator.simulate(values, active=[0, 1, 2])
    assert run.sensitivities is not None
    y, s = run.outputs[0][0], run.sensitivities[0][0]
    expected, cost, gradient, hessian = 0.0, 0.0, np.zeros(3), np.zeros((3, 3))
    for output in range(2):
        seen = ~np.isnan(measured[:, output])
        if not seen.any():
            continue
        k = covariance(time[seen], tuple(noises[0, output]))
        r, slopes = (y - measured)[seen, output], s[seen, output]
        expected += multivariate_normal(np.zeros(r.size), k, allow_singular=True).logpdf(r)
        weighed = np.linalg.solve(k, np.column_stack([r, slopes]))
        cost += 0.5 * r @ weighed[:, 0]
        gradient += slopes.T @ weighed[:, 0]
        hessian += slopes.T @ weighed[:, 1:]
    np.testing.assert_allclose(likelihood, expected, rtol=1e-7)
    np.testing.assert_allclose(gn.log_likelihood[0], expected, rtol=1e-7)
    np.testing.assert_allclose(gn.cost[0], cost, rtol=1e-7)
    np.testing.assert_allclose(gn.gradient[0], gradient, rtol=1e-6, atol=1e-7 * np.abs(gradient).max())
    np.testing.assert_allclose(gn.hessian[0], hessian, rtol=1e-6, atol=1e-8 * np.abs(hessian).max())
    other = gauss_newton_products(time, measured, y, s, noises[0])
    np.testing.assert_allclose(other[3], expected, rtol=1e-8)
    np.testing.assert_allclose(other[2], hessian, rtol=1e-7, atol=1e-9 * np.abs(hessian).max())


def test_gradient_is_the_slope_of_the_cost(test_fmu, here):
    time = np.linspace(0.0, 2.0, 101)
    measured = np.exp(-time)[:, None] + 0.1 * np.random.default_rng(3).standard_normal((101, 1))
    targets = (ParameterTarget("k"), StartTarget("x"))
    experiments = (Experiment(time, ("x",), measured=measured), Experiment(time + 1.0, ("x",), measured=measured))
    problem = Problem(
        test_fmu("Dahlquist"), experiments, (targets, (targets[0], None)), settings=SolverSettings(1e-11, 1e-11)
    )
    noise = np.array([0.1, 0.05, 0.1])
    point, step = np.array([1.2, 0.9]), 1e-5
    with NativeSimulator(problem, pool=here) as simulator:
        found = simulator.gauss_newton(point[None], noise, active=[0, 1])
        moved = simulator.gauss_newton(point + step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]), noise, active=[])
    slope = [(moved.cost[0] - moved.cost[1]) / (2 * step), (moved.cost[2] - moved.cost[3]) / (2 * step)]
    np.testing.assert_allclose(found.gradient[0], slope, rtol=1e-5)
    assert np.array_equal(found.hessian[0], found.hessian[0].T)
