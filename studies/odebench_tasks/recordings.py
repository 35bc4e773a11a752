"""Trajectories of a system, recordings of them with noise, and how far a deleted term shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from odebench_tasks.systems import System, Task

FloatArray = NDArray[np.float64]

#: Length of a recording in s, that of the benchmark, and its samples.
DURATION, SAMPLES = 10.0, 200
#: Largest magnitude of a state that is simulated.
MAX_STATE = 1e8


def trajectory(system: System, start: Sequence[float], constants: Sequence[float] | None = None) -> FloatArray | None:
    """States (n, s) at the samples; None where they cannot be simulated."""
    names = [*system.constants]
    values = list(system.constants.values()) if constants is None else constants
    rates = [sum(rate, sympy.S.Zero) for rate in system.rates]
    call = sympy.lambdify([*system.states, *names], rates, "numpy")

    def rate(t: float, x: FloatArray) -> FloatArray:
        if not np.max(np.abs(x)) < MAX_STATE:
            raise OverflowError
        return np.array([float(v) for v in call(*x, *values)])

    try:
        with np.errstate(all="ignore"):
            run = solve_ivp(rate, (0.0, DURATION), start, "LSODA", times(), rtol=1e-8, atol=1e-9)
    except (OverflowError, ValueError, ZeroDivisionError, TypeError):
        return None
    return run.y.T if run.success and run.y.shape[1] == SAMPLES and np.all(np.isfinite(run.y)) else None


def times() -> FloatArray:
    """Sample times (n,) in s."""
    return np.linspace(0.0, DURATION, SAMPLES)


def noisy_runs(task: Task, seed: int) -> list[FloatArray] | None:
    """Readings (n, s) from each start; the second one is for the judgement. None where the system cannot be simulated.

    The noise of both is that of the first, a share of each state's standard deviation there.
    """
    clean = [trajectory(task.system, start) for start in task.system.starts]
    if any(x is None for x in clean):
        return None
    rng = np.random.default_rng([seed, task.system.number, sum(map(ord, task.key))])
    sd = task.noise * np.std(clean[0], axis=0)  # type: ignore[arg-type]
    return [x + sd * rng.standard_normal(x.shape) for x in clean if x is not None]


def visibility(task: Task) -> float:
    """How far the deleted term shows, in standard deviations of the noise: what the best fit without it leaves."""
    clean = trajectory(task.system, task.system.starts[0])
    if clean is None:
        return 0.0
    less, recorded = task.first_model, [k for k in range(clean.shape[1]) if k != task.hidden]
    sd = task.noise * np.std(clean, axis=0)
    if np.any(sd[recorded] <= 0.0):
        return 0.0
    count = len(less.constants)

    def residual(p: FloatArray) -> FloatArray:
        run = trajectory(less, p[count:], p[:count])
        if run is None:
            return np.full(SAMPLES * len(recorded), 1e3)
        return np.clip(((run - clean) / sd)[:, recorded].ravel(), -1e3, 1e3)

    start = np.array([*less.constants.values(), *task.system.starts[0]])
    scale = np.maximum(np.abs(start), 0.1)
    best = least_squares(residual, start, x_scale=scale, max_nfev=40)
    return float(np.linalg.norm(best.fun))
