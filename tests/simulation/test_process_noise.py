"""The filter of a model with process noise, against Gaussian processes in closed form and against other filters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.export import export_fmu
from aero_bayes.simulation import (
    DiffusionTarget,
    Experiment,
    InputSignal,
    Model,
    NativeSimulator,
    ParameterTarget,
    Problem,
    ProcessNoise,
    ReadingNoiseTarget,
    SolverSettings,
    StartTarget,
    WorkerPool,
    open_simulator,
)

EXACT = SolverSettings(1e-11, 1e-13)

OSCILLATOR = """model Oscillator
  parameter Real k = 4.0; parameter Real d = 0.6; parameter Real m = 0.5;
  input Real F(start = 0); Real x(start = 0.3); Real v(start = -0.1); output Real y; output Real a;
equation
  der(x) = v; m * der(v) = F - k * x - d * v; y = x; a = der(v);
end Oscillator;
"""

PENDULUM = """model Pendulum
  parameter Real w = 3.0; parameter Real d = 0.4;
  input Real u(start = 0); Real q(start = 1.2); Real v(start = 0); output Real angle; output Real height;
equation
  der(q) = v; der(v) = u - w ^ 2 * sin(q) - d * v; angle = q; height = 1 - cos(q);
end Pendulum;
"""


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    folder, models = tmp_path_factory.mktemp("noisy"), {}

    def load(source: str, **options: object) -> Model:
        name = source.split()[1]
        if name not in models:
            path = folder / f"{name}.mo"
            path.write_text(source)
            models[name] = Model.load(export_fmu(name, folder / f"{name}.fmu", sources=[path]))
        return models[name]

    return load


class Oscillator:
    """The linear rig in matrices: mean and covariance of all its readings together."""

    def __init__(self, k: float, d: float, m: float, sigma: tuple[float, float], initial: tuple[float, float]) -> None:
        self.a = np.array([[0.0, 1.0], [-k / m, -d / m]])
        self.b = np.array([0.0, 1.0 / m])
        self.q, self.p0 = np.diag(sigma) ** 2, np.diag(initial) ** 2
        self.values, self.vectors = np.linalg.eig(self.a)
        self.inverse = np.linalg.inv(self.vectors)
        self.c, self.feed = np.array([[1.0, 0.0], [-k / m, -d / m]]), np.array([0.0, 1.0 / m])

    def covariance(self, t: float) -> np.ndarray:
        """Of the state at t, in the coordinates in which the system is diagonal."""
        rotated = self.inverse @ self.q @ self.inverse.T
        pairs = self.values[:, None] + self.values[None, :]
        grown = self.vectors @ (rotated * (np.exp(pairs * t) - 1.0) / pairs) @ self.vectors.T
        return expm(self.a * t) @ self.p0 @ expm(self.a.T * t) + grown.real

    def mean(self, x0: np.ndarray, time: np.ndarray, signal: InputSignal) -> np.ndarray:
        """States at increasing times under a held input."""
        edges = np.unique(np.concatenate((time, signal.time)))
        x, t, found = np.asarray(x0, dtype=float), time[0], {time[0]: np.asarray(x0, dtype=float)}
        for end in edges[edges > time[0]]:
            u = signal.values[np.searchsorted(signal.time, t, side="right") - 1]
            phi = expm(self.a * (end - t))
            x = phi @ x + np.linalg.solve(self.a, (phi - np.eye(2)) @ self.b) * u
            t = end
            found[end] = x
        return np.stack([found[t] for t in time])

    def log_density(self, x0, time, signal, measured, sd) -> float:
        states = self.mean(x0, time, signal)
        u = signal.values[np.searchsorted(signal.time, time, side="right") - 1]
        mean = states @ self.c.T + u[:, None] * self.feed
        n = len(time)
        full = np.zeros((n, 2, n, 2))
        for i in range(n):
            p = self.covariance(time[i] - time[0])
            for j in range(i, n):
                full[j, :, i, :] = self.c @ expm(self.a * (time[j] - time[i])) @ p @ self.c.T
                full[i, :, j, :] = full[j, :, i, :].T
            full[i, range(2), i, range(2)] += np.square(sd)
        seen = np.isfinite(measured).ravel()
        return float(
            multivariate_normal(mean.ravel()[seen], full.reshape(2 * n, 2 * n)[np.ix_(seen, seen)]).logpdf(
                measured.ravel()[seen]
            )
        )


def oscillator_case(rng):
    time = np.concatenate(([0.0], np.sort(rng.uniform(0.0, 3.0, 60))))
    signal = InputSignal("F", np.array([0.0, 0.7, 1.1, 2.0]), np.array([1.0, -2.0, 0.5, 0.0]))
    measured = rng.normal(0.0, 0.5, (time.size, 2))
    measured[rng.random(measured.shape) < 0.25] = np.nan
    measured[10:14] = np.nan
    return time, signal, measured


@pytest.mark.parametrize("settings", [SolverSettings(), EXACT], ids=["as usual", "exact"])
def test_linear_rig_has_the_likelihood_of_its_gaussian_process(built, here, rng, settings):
    time, signal, measured = oscillator_case(rng)
    experiment = Experiment(time, ("y", "a"), (signal,), measured=measured)
    k, d, m, sigma, initial, sd = 4.0, 0.6, 0.5, (0.05, 0.7), (0.1, 0.2), (0.03, 0.4)
    process = ProcessNoise({"y": 9.0}, dict(zip("yv", initial, strict=True)), {"y": 9.0, "a": sd[1]})
    targets = (ParameterTarget("k"), DiffusionTarget("y"), DiffusionTarget("v"), ReadingNoiseTarget("y"))
    problem = Problem(built(OSCILLATOR), (experiment,), (targets,), settings=settings, process=process)
    with NativeSimulator(problem, pool=here) as simulator:
        found = simulator.log_likelihood(np.array([[k, *sigma, sd[0]]]), np.ones(3)).log_likelihood[0, 0]
    exact = Oscillator(k, d, m, sigma, initial).log_density((0.3, -0.1), time, signal, measured, sd)
    assert found == pytest.approx(exact, rel=1e-8 if settings is EXACT else 1e-5)
