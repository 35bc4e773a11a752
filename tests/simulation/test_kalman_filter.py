"""The filter of a model with process noise, against Gaussian processes in closed form and against other filters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.simulation.interface import (
    DiffusionTarget,
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    ProcessNoise,
    ReadingNoiseTarget,
    SolverSettings,
    StartTarget,
    smooth,
)
from aero_bayes.simulation.native_simulator import NativeSimulator

pytestmark = pytest.mark.fast

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


class Oscillator:
    """The linear rig in matrices: mean and covariance of all its readings together."""

    def __init__(self, k: float, d: float, m: float, sigma: tuple[float, float], initial: tuple[float, float]) -> None:
        self.a = np.array([[0.0, 1.0], [-k / m, -d / m]])
        self.b = np.array([0.0, 1.0 / m])
        self.q, self.p0 = np.diag(sigma) ** 2, np.diag(initial) ** 2
        self.c, self.feed = np.array([[1.0, 0.0], [-k / m, -d / m]]), np.array([0.0, 1.0 / m])

    def covariance(self, t: float) -> np.ndarray:
        """Of the state at t, by Van Loan's exponential of a block matrix."""
        blocks = expm(t * np.block([[-self.a, self.q], [np.zeros((2, 2)), self.a.T]]))
        phi = blocks[2:, 2:].T
        return phi @ self.p0 @ phi.T + phi @ blocks[:2, 2:]

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

    def prior(self, time: np.ndarray) -> np.ndarray:
        """Covariance of all states at increasing times, one sample after the other."""
        n = len(time)
        full = np.zeros((n, 2, n, 2))
        for i in range(n):
            p = self.covariance(time[i] - time[0])
            for j in range(i, n):
                full[j, :, i, :] = expm(self.a * (time[j] - time[i])) @ p
                full[i, :, j, :] = full[j, :, i, :].T
        return full.reshape(2 * n, 2 * n)

    def readings(self, x0, time, signal, sd) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean of all readings, their slopes by all states, and their covariance."""
        u = signal.values[np.searchsorted(signal.time, time, side="right") - 1]
        mean = self.mean(x0, time, signal) @ self.c.T + u[:, None] * self.feed
        slopes = np.kron(np.eye(len(time)), self.c)
        return mean.ravel(), slopes, slopes @ self.prior(time) @ slopes.T + np.diag(np.tile(np.square(sd), len(time)))


def oscillator_case(rng, moves):
    time = np.concatenate(([0.0], np.sort(rng.uniform(0.0, 3.0, 60))))
    signal = InputSignal("F", np.array([0.0, 0.7, 1.1, 2.0]), np.array([1.0, -2.0, 0.5, 0.0]))
    if moves:
        signal = InputSignal("F", time, np.random.default_rng(8).standard_normal(time.size))
    measured = rng.normal(0.0, 0.5, (time.size, 2))
    measured[rng.random(measured.shape) < 0.25] = np.nan
    measured[10:14] = np.nan
    return time, signal, measured


@pytest.mark.parametrize("moves", [False, True], ids=["rare jumps", "held samples"])
@pytest.mark.parametrize("settings", [SolverSettings(), EXACT], ids=["as usual", "exact"])
def test_linear_rig_has_the_likelihood_of_its_gaussian_process(exported, here, rng, settings, moves):
    time, signal, measured = oscillator_case(rng, moves)
    k, d, m, sigma, initial, sd = 4.0, 0.6, 0.5, (0.05, 0.7), (0.1, 0.2), (0.03, 0.4)
    start_sd = dict(zip("yv", initial, strict=True))
    experiment = Experiment(time, ("y", "a"), (signal,), measured=measured, start_sd=start_sd)
    process = ProcessNoise({"y": 9.0}, {"y": 9.0, "a": sd[1]})
    targets = (ParameterTarget("k"), DiffusionTarget("y"), DiffusionTarget("v"), ReadingNoiseTarget("y"))
    problem = Problem(exported(OSCILLATOR), (experiment,), (targets,), settings=settings, process=process)
    with NativeSimulator(problem, pool=here) as simulator:
        found = simulator.log_likelihood(np.array([[k, *sigma, sd[0]]]), np.ones(3)).log_likelihood[0, 0]
    mean, _, covariance = Oscillator(k, d, m, sigma, initial).readings((0.3, -0.1), time, signal, sd)
    seen = np.isfinite(measured).ravel()
    exact = multivariate_normal(mean[seen], covariance[np.ix_(seen, seen)]).logpdf(measured.ravel()[seen])
    assert found == pytest.approx(exact, rel=1e-8 if settings is EXACT else 1e-5)


@pytest.mark.parametrize("moves", [False, True], ids=["rare jumps", "held samples"])
def test_smoothed_states_are_those_of_the_gaussian_process(exported, here, rng, moves):
    time, signal, measured = oscillator_case(rng, moves)
    sigma, initial, sd = (0.0, 0.7), (0.1, 0.0), (0.03, 0.4)
    experiment = Experiment(time, ("y", "a"), (signal,), measured=measured, start_sd={"y": initial[0]})
    process = ProcessNoise({"v": sigma[1]}, dict(zip("ya", sd, strict=True)))
    problem = Problem(exported(OSCILLATOR), (experiment,), ((),), settings=EXACT, process=process)
    with NativeSimulator(problem, pool=here) as simulator:
        (states,) = simulator.filtered_states(np.empty(0))
    found = smooth(states, measured)

    rig = Oscillator(4.0, 0.6, 0.5, sigma, initial)
    prior, states = rig.prior(time), rig.mean((0.3, -0.1), time, signal)
    mean, slopes, covariance = rig.readings((0.3, -0.1), time, signal, sd)
    seen = np.isfinite(measured).ravel()
    slopes, away = slopes[seen], measured.ravel()[seen] - mean[seen]
    gain = np.linalg.solve(covariance[np.ix_(seen, seen)], slopes @ prior).T
    np.testing.assert_allclose(found.mean.ravel(), states.ravel() + gain @ away, atol=1e-7)
    variance = np.diag(prior - gain @ slopes @ prior)
    np.testing.assert_allclose(found.sd.ravel() ** 2, variance, atol=1e-8)


def pendulum_filter(time, u, measured, w, d, sigma, sd, p0):
    """An extended Kalman filter by the moments' differential equations, both readings taken at once."""

    def rates(t, z, force):
        x, p = z[:2], z[2:].reshape(2, 2)
        a = np.array([[0.0, 1.0], [-(w**2) * np.cos(x[0]), -d]])
        f = [x[1], force - w**2 * np.sin(x[0]) - d * x[1]]
        return np.concatenate([f, (a @ p + p @ a.T + np.diag(np.square(sigma))).ravel()])

    x, p, total = np.array([1.2, 0.0]), np.diag(np.square(p0)), 0.0
    for k, t in enumerate(time):
        if k:
            z = np.concatenate([x, p.ravel()])
            z = solve_ivp(rates, (time[k - 1], t), z, args=(u[k - 1],), rtol=1e-10, atol=1e-12).y[:, -1]
            x, p = z[:2], z[2:].reshape(2, 2)
        seen = np.isfinite(measured[k])
        h = np.array([[1.0, 0.0], [np.sin(x[0]), 0.0]])[seen]
        away = (measured[k] - np.array([x[0], 1.0 - np.cos(x[0])]))[seen]
        s = h @ p @ h.T + np.diag(np.square(sd))[np.ix_(seen, seen)]
        total += multivariate_normal(np.zeros(seen.sum()), s).logpdf(away) if seen.any() else 0.0
        gain = np.linalg.solve(s, h @ p).T
        x, p = x + gain @ away, p - gain @ h @ p
    return total


def pendulum_case(rng):
    time = np.arange(0.0, 4.0, 0.1)
    u = np.sign(np.sin(2.0 * time))
    angle = 0.8 * np.cos(2.5 * time) + rng.normal(0.0, 0.2, time.size)
    measured = np.stack([angle, 1.0 - np.cos(angle) + rng.normal(0.0, 0.1, time.size)], axis=1)
    measured[::3, 1] = np.nan
    measured[12:15] = np.nan
    return Experiment(time, ("angle", "height"), (InputSignal("u", time, u),), measured=measured), u


PENDULUM_TARGETS = (
    ParameterTarget("w"), ParameterTarget("d"), DiffusionTarget("v"), ReadingNoiseTarget("angle"),
    ReadingNoiseTarget("height"), StartTarget("v"),
)  # fmt: skip
PENDULUM_VALUES = (3.0, 0.4, 0.8, 0.1, 0.15, 0.0)


def test_nonlinear_rig_has_the_likelihood_of_another_filter(exported, here, rng):
    experiment, u = pendulum_case(rng)
    experiment = replace(experiment, start_sd={"angle": 0.1, "v": 0.2})
    process = ProcessNoise({"angle": 0.05})
    problem = Problem(exported(PENDULUM), (experiment,), (PENDULUM_TARGETS,), process=process)
    with NativeSimulator(problem, pool=here) as simulator:
        found = simulator.log_likelihood(np.array([PENDULUM_VALUES]), np.ones(3)).log_likelihood[0, 0]
    exact = pendulum_filter(experiment.time, u, experiment.measured, 3.0, 0.4, (0.05, 0.8), (0.1, 0.15), (0.1, 0.2))
    assert found == pytest.approx(exact, abs=1e-4)


def test_slopes_of_predictions_and_variances_are_those_of_differences(exported, here, rng):
    experiment, _ = pendulum_case(rng)
    columns = range(len(PENDULUM_TARGETS))
    experiment, process = replace(experiment, start_sd={"angle": 0.1}), ProcessNoise()
    problem = Problem(exported(PENDULUM), (experiment,), (PENDULUM_TARGETS,), settings=EXACT, process=process)
    step = 1e-4
    with NativeSimulator(problem, pool=here) as simulator:
        at = np.array(PENDULUM_VALUES)
        found = simulator.filter(at[None], active=columns)
        beside = simulator.filter(np.concatenate([at + step * np.eye(len(at)), at - step * np.eye(len(at))]))
    for slopes, values in ((found.predicted_slopes, beside.predicted), (found.variance_slopes, beside.variance)):
        up, down = np.split(values[0], 2)
        expected = np.moveaxis((up - down) / (2.0 * step), 0, -1)
        np.testing.assert_allclose(slopes[0][0], expected, atol=2e-5 * np.max(np.abs(expected)))


def test_a_stiff_rig_without_derivatives_of_its_fmu(test_fmu, here, rng):
    # x' = -k x + b u: variance of a reading given the one before, in closed form
    time = np.cumsum(rng.uniform(0.05, 0.5, 40))
    x = rng.normal(0.0, 1.0, time.size)
    k, sigma, sd = 1e4, 30.0, 0.1
    signal = InputSignal("u", time, rng.normal(0.0, 1.0, 40))
    experiment = Experiment(time, ("x",), (signal,), measured=x[:, None], start_sd={"x": 1.0})
    process = ProcessNoise({"x": sigma}, {"x": sd})
    for directional in (True, False):
        problem = Problem(
            test_fmu("Dahlquist", directional=directional), (experiment,), ((),), {"k": k}, process=process
        )
        with NativeSimulator(problem, pool=here) as simulator:
            variance = simulator.filter(np.empty((1, 0))).variance[0][0, :, 0]
        np.testing.assert_allclose(variance[1:], sigma**2 / (2.0 * k) + sd**2, rtol=1e-6 if directional else 1e-5)
        assert variance[0] == pytest.approx(1.0 + sd**2)


def test_what_cannot_be_filtered_is_one_line(test_fmu, here):
    time = np.linspace(0.0, 3.0, 31)
    experiment = Experiment(time, ("h",), measured=np.ones((31, 1)))
    process = ProcessNoise({"v": 0.1}, reading_sd={"h": 0.1})
    ball = test_fmu("BouncingBall")
    with NativeSimulator(Problem(ball, (experiment,), ((),), process=process), pool=here) as simulator:
        assert simulator.filter(np.empty((1, 0))).outcomes[0, 0] == Outcome.STATES_JUMP
        with pytest.raises(CannotFinishError, match="jumps"):
            simulator.filtered_states(np.empty(0))
    with pytest.raises(InputError, match="no state 'w'"):
        NativeSimulator(Problem(ball, (experiment,), ((),), process=ProcessNoise({"w": 0.1})), pool=here)
