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
def test_likelihood(test_fmu, here, grid, noise, gaps):
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
        y = simulator.simulate(values).outputs[0][0]
    expected = 0.0
    for output in range(2):
        seen = ~np.isnan(measured[:, output])
        if not seen.any():
            continue
        k = covariance(time[seen], tuple(noises[0, output]))
        r = (y - measured)[seen, output]
        expected += multivariate_normal(np.zeros(r.size), k, allow_singular=True).logpdf(r)
    np.testing.assert_allclose(likelihood, expected, rtol=1e-7)
