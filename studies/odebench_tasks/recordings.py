"""Trajectories of a system, recordings of them with noise, and how far a deleted term shows."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.integrate import ODEintWarning, odeint
from scipy.optimize import least_squares

from odebench_tasks.systems import System, Task

FloatArray = NDArray[np.float64]

#: Length of a recording in s, that of the benchmark, and its samples.
DURATION, SAMPLES = 10.0, 200
#: Largest magnitude of a state that is simulated.
MAX_STATE = 1e8
#: Evaluations of the rates after which a run is given up: the published systems take some thousand.
MAX_CALLS = 50_000


def trajectory(system: System, start: Sequence[float]) -> FloatArray | None:
    """Simulate states (n, s) at the samples; None where they cannot be."""
    return _run(_rates(system), start, [*system.constants.values()])


def _rates(system: System) -> Callable[..., list[float]]:
    """Return the rates as a function of states and constants."""
    rates = [sum(rate, sympy.S.Zero) for rate in system.rates]
    return cast(Callable[..., list[float]], sympy.lambdify([*system.states, *system.constants], rates, "math"))


def _run(call: Callable[..., list[float]], start: Sequence[float], constants: Sequence[float]) -> FloatArray | None:
    """Simulate states (n, s) by the quick solver of ODEPACK; None where it fails."""
    calls = iter(range(MAX_CALLS))

    def rate(x: FloatArray, t: float) -> list[float]:
        states = x.tolist()
        if not max(map(abs, states)) < MAX_STATE or next(calls, None) is None:
            raise OverflowError
        return call(*states, *constants)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", ODEintWarning)
            states = odeint(rate, start, times(), rtol=1e-8, atol=1e-9, mxstep=MAX_CALLS)
    except (ArithmeticError, ValueError, TypeError, ODEintWarning):
        return None
    return states if np.all(np.isfinite(states)) else None


def can_be_simulated(system: System) -> bool:
    """Return whether a system goes on to the end from both of its starts."""
    return all(trajectory(system, start) is not None for start in system.starts)


def times() -> FloatArray:
    """Sample times (n,) in s."""
    return np.linspace(0.0, DURATION, SAMPLES)


def noisy_runs(task: Task, seed: int) -> list[FloatArray]:
    """Read states (n, s) with noise from each start of a system that can be simulated; the second is for the judgement.

    The noise of both is that of the first, a share of each state's standard deviation there.
    """
    clean = [cast(FloatArray, trajectory(task.system, start)) for start in task.system.starts]
    rng = np.random.default_rng([seed, task.system.number, sum(map(ord, task.key))])
    sd = task.noise * np.std(clean[0], axis=0)
    return [x + sd * rng.standard_normal(x.shape) for x in clean]


def visibility(task: Task) -> float:
    """Return how far the deleted term shows, in standard deviations of the noise.

    What the best fit without it leaves.
    """
    clean = trajectory(task.system, task.system.starts[0])
    if clean is None:
        return 0.0
    less, recorded = task.first_model, [k for k in range(clean.shape[1]) if k != task.hidden]
    sd = task.noise * np.std(clean, axis=0)
    if np.any(sd[recorded] <= 0.0):
        return 0.0
    count, call = len(less.constants), _rates(less)

    def residual(p: FloatArray) -> FloatArray:
        run = _run(call, p[count:].tolist(), p[:count].tolist())
        if run is None:
            return np.full(SAMPLES * len(recorded), 1e3)
        return np.clip(((run - clean) / sd)[:, recorded].ravel(), -1e3, 1e3)

    start = np.array([*less.constants.values(), *task.system.starts[0]])
    scale = np.maximum(np.abs(start), 0.1)
    best = least_squares(residual, start, x_scale=scale, max_nfev=40, diff_step=1e-5)
    return float(np.linalg.norm(best.fun))
