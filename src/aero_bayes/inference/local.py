"""Bounded local search: Levenberg-Marquardt on Gauss-Newton products, many starts in one batch.

Every iteration minimises the damped quadratic model inside the box (an active-set method), so that a parameter at its
bound stays out of the way; the damping follows Nielsen (1999), "Damping parameter in Marquardt's method".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Stop(Enum):
    """Why a local search ended; the value is what a person reads."""

    CONVERGED = "converged: no step inside the bounds would lower the cost noticeably"
    SMALL_STEP = "converged: the steps became smaller than the tolerance"
    NO_PROGRESS = "no step lowered the cost although the model of it promised one"
    ITERATION_LIMIT = "the iteration limit was reached"
    FAILED_START = "the simulation failed at the starting point"

    @property
    def converged(self) -> bool:
        return self in (Stop.CONVERGED, Stop.SMALL_STEP)


@dataclass(frozen=True)
class Products:
    """Cost, gradient and Gauss-Newton Hessian at a batch of points: shapes (k,), (k, p), (k, p, p).

    The cost is not finite where the evaluation failed.
    """

    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray


@dataclass(frozen=True)
class LocalSettings:
    """Limits of a local search.

    ``tolerance`` is the predicted decrease of the cost (in its own unit; for a log-posterior: nats) below which the
    search has converged; ``step_tolerance`` the relative size of a step.
    """

    max_iterations: int = 60
    tolerance: float = 1e-7
    relative_tolerance: float = 1e-13
    step_tolerance: float = 1e-11
    damping: float = 1e-3


@dataclass(frozen=True)
class LocalResult:
    """Ends of the searches, one row a start: ``points`` (k, p), ``cost`` (k,), ``hessian`` (k, p, p)."""

    points: FloatArray
    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    iterations: NDArray[np.int64]
    reasons: tuple[Stop, ...]
    evaluations: int
    failures: int

    @property
    def best(self) -> int:
        return int(np.argmin(np.where(np.isfinite(self.cost), self.cost, np.inf)))


def bounded_step(hessian: FloatArray, gradient: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Minimiser of ``g'd + d'Hd/2`` over ``low <= d <= high`` for a positive definite H, shape (p,).

    Projected Newton with an active set (Bertsekas, 1982): free the coordinates that want to leave their bound, fix
    those that a full step would carry outside, until neither happens.
    """
    p = gradient.size
    step = np.zeros(p)
    held = low == high
    step[held] = low[held]
    fixed = held | ((low >= 0.0) & (gradient > 0.0)) | ((high <= 0.0) & (gradient < 0.0))
    for _ in range(4 * p + 4):
        free = ~fixed
        if free.any():
            right = gradient[free] + hessian[np.ix_(free, fixed)] @ step[fixed]
            target = -np.linalg.solve(hessian[np.ix_(free, free)], right)
            move = target - step[free]
            room = np.where(move > 0.0, high[free] - step[free], low[free] - step[free])
            ratio = np.where(np.abs(move) > np.abs(room), room / np.where(move == 0.0, 1.0, move), 1.0)
            share = float(ratio.min())
            step[free] += share * move
            if share < 1.0:
                tightest = int(np.argmin(ratio))
                column = int(np.flatnonzero(free)[tightest])
                step[column] = high[column] if move[tightest] > 0.0 else low[column]
                fixed[column] = True
                continue
        slope = gradient + hessian @ step
        leaving = fixed & ~held & (((step <= low) & (slope < -1e-14)) | ((step >= high) & (slope > 1e-14)))
        if not leaving.any():
            break
        fixed[int(np.argmax(np.where(leaving, np.abs(slope), 0.0)))] = False
    return np.clip(step, low, high)


def search(
    products: Callable[[FloatArray], Products],
    starts: FloatArray,
    low: FloatArray,
    high: FloatArray,
    settings: LocalSettings | None = None,
    cost: Callable[[FloatArray], FloatArray] | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> LocalResult:
    """Minimise from every start at once.

    Parameters
    ----------
    products : callable
        Maps points (k, p) to :class:`Products`.
    starts : ndarray, shape (k, p)
    low, high : ndarray, shape (p,) or (k, p)
        Bounds, of all starts or of each; equal ones hold a coordinate.
    settings : LocalSettings, optional
    cost : callable, optional
        The cost alone, (k, p) to (k,). With it, steps are tried on the cost, which is several times cheaper, and the
        products are evaluated where a step was taken.
    progress : callable, optional
        Told the iteration and the best cost.
    """
    settings = settings or LocalSettings()
    points = np.clip(np.atleast_2d(np.asarray(starts, dtype=np.float64)), low, high)
    count, p = points.shape
    low, high = np.broadcast_to(low, points.shape), np.broadcast_to(high, points.shape)
    here = products(points)
    now, gradient, hessian = here.cost.copy(), here.gradient.copy(), here.hessian.copy()
    evaluations, failures = count, int(np.sum(~np.isfinite(now)))
    damping, growth = np.full(count, settings.damping), np.full(count, 2.0)
    iterations = np.zeros(count, dtype=np.int64)
    reasons: list[Stop | None] = [None if np.isfinite(c) else Stop.FAILED_START for c in now]
    ceiling = np.zeros((count, p))
    for iteration in range(settings.max_iterations):
        running = np.array([k for k in range(count) if reasons[k] is None], dtype=np.int64)
        if running.size == 0:
            break
        trial, promised = points[running].copy(), np.zeros(running.size)
        for row, k in enumerate(running):
            step, promised[row], reasons[k] = _propose(
                points[k], now[k], gradient[k], hessian[k], ceiling[k], damping[k], low[k], high[k], settings
            )
            trial[row] = points[k] + step
        going = np.array([reasons[k] is None for k in running], dtype=bool)
        running, trial, promised = running[going], trial[going], promised[going]
        if running.size == 0:
            break
        trial_cost, there = _evaluate(products, cost, trial, now[running])
        evaluations += running.size
        failures += int(np.sum(~np.isfinite(trial_cost)))
        iterations[running] += 1
        taken = np.where(np.isfinite(trial_cost), trial_cost, np.inf) < now[running]
        for row, k in enumerate(running):
            if taken[row]:
                ratio = (now[k] - trial_cost[row]) / promised[row]
                damping[k] *= max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
                damping[k], growth[k] = max(damping[k], 1e-12), 2.0
                points[k], now[k] = trial[row], there.cost[row]
                gradient[k], hessian[k] = there.gradient[row], there.hessian[row]
            else:
                damping[k] *= growth[k]
                growth[k] *= 2.0
                if damping[k] > 1e15:
                    reasons[k] = Stop.NO_PROGRESS
        if progress is not None:
            progress(iteration, float(np.min(now)))
    ended = tuple(reason or Stop.ITERATION_LIMIT for reason in reasons)
    return LocalResult(points, now, gradient, hessian, iterations, ended, evaluations, failures)


def _propose(
    point: FloatArray,
    cost: float,
    gradient: FloatArray,
    hessian: FloatArray,
    ceiling: FloatArray,
    damping: float,
    low: FloatArray,
    high: FloatArray,
    settings: LocalSettings,
) -> tuple[FloatArray, float, Stop | None]:
    """A damped step from a point, the decrease it promises, and whether to stop instead."""
    np.maximum(ceiling, np.diag(hessian), out=ceiling)
    scale = np.where(ceiling > 0.0, ceiling, 1.0)
    room_low, room_high = low - point, high - point
    tiny = np.diag(1e-14 * scale)
    newton = bounded_step(hessian + np.diag(1e-10 * scale), gradient, room_low, room_high)
    possible = -float(gradient @ newton + 0.5 * newton @ hessian @ newton)
    if possible <= max(settings.tolerance, settings.relative_tolerance * abs(cost)):
        return newton, possible, Stop.CONVERGED
    step = bounded_step(hessian + tiny + np.diag(damping * scale), gradient, room_low, room_high)
    promised = -float(gradient @ step + 0.5 * step @ hessian @ step)
    if np.all(np.abs(step) <= settings.step_tolerance * (np.abs(point) + settings.step_tolerance)):
        return step, promised, Stop.SMALL_STEP
    return step, max(promised, 1e-300), None


def _evaluate(
    products: Callable[[FloatArray], Products],
    cost: Callable[[FloatArray], FloatArray] | None,
    trial: FloatArray,
    now: FloatArray,
) -> tuple[FloatArray, Products]:
    """Cost of the trial points, and products of those that are better (zeros elsewhere)."""
    if cost is None:
        there = products(trial)
        return there.cost, there
    value = np.asarray(cost(trial), dtype=np.float64)
    better = np.isfinite(value) & (value < now)
    k, p = trial.shape
    full = Products(value.copy(), np.zeros((k, p)), np.zeros((k, p, p)))
    if better.any():
        there = products(trial[better])
        full.cost[better], full.gradient[better], full.hessian[better] = there.cost, there.gradient, there.hessian
        bad = ~np.isfinite(full.cost)
        value[bad] = np.inf
    return value, full
