"""Bounded local search: Levenberg-Marquardt steps over any ground that has a value, a slope and a curvature.

Every step minimises the damped quadratic model inside the box (an active-set method), so that a parameter at its bound
stays out of the way; the damping follows Nielsen (1999), "Damping parameter in Marquardt's method". After each step the
ground may be surveyed anew at the same place (a likelihood renews its noise).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.way import Shape, Way

FloatArray = NDArray[np.float64]


#: How many times its last :data:`LATELY` steps, or what the next one promises, a search is trusted to go on.
REACH, LATELY = 20.0, 3


class Stop(Enum):
    """Why a local search ended; the value is what a person reads."""

    CONVERGED = "converged: no step inside the bounds would lower the cost noticeably"
    SMALL_STEP = "converged: the steps became smaller than the tolerance"
    BEATEN = "given up: what it has gained lately would not take it as far as it had to come"
    MET = "given up: it led where an earlier one had come to"
    NO_PROGRESS = "no step lowered the cost although the model of it promised one"
    ITERATION_LIMIT = "the iteration limit was reached"
    FAILED_START = "the simulation failed at the starting point"

    @property
    def converged(self) -> bool:
        return self in (Stop.CONVERGED, Stop.SMALL_STEP)


@dataclass(frozen=True, eq=False)
class Ground:
    """Cost, gradient (p,) and curvature (p, p) at one point."""

    cost: float
    gradient: FloatArray
    hessian: FloatArray

    def promise(self, step: FloatArray) -> float:
        """By how much a step lowers the quadratic model of the cost."""
        return -float(self.gradient @ step + 0.5 * step @ self.hessian @ step)


G = TypeVar("G", bound=Ground)


class Terrain(Protocol[G]):
    """What a search walks over: a user's own objective has these two methods."""

    def look(self, point: FloatArray) -> G | None:
        """The ground at a point (p,); None where it cannot be evaluated."""
        ...

    def renew(self, here: G) -> G:
        """The same place surveyed anew, not higher than before; ``here`` itself where there is nothing to renew."""
        ...


@dataclass(frozen=True)
class Plain:
    """A terrain that stays as it is, given by a function of the point."""

    ground: Callable[[FloatArray], Ground | None]

    def look(self, point: FloatArray) -> Ground | None:
        return self.ground(point)

    def renew(self, here: Ground) -> Ground:
        return here


@dataclass(frozen=True)
class LocalSettings:
    """Limits of a local search.

    ``tolerance`` is the predicted decrease of the cost (in its own unit; for a log-posterior: nats) below which the
    search has converged; ``step_tolerance`` the relative size of a step; ``renewal`` the decrease by a new survey that
    keeps it going; ``rejections`` how many steps in a row may fail to lower the cost, and
    ``worthwhile`` the decrease that one of two steps in a row must bring (along a kink a search creeps for ever). A
    search that is farther above ``aim`` than the last steps that lowered the cost and the next one would bring it
    :data:`REACH` times over is given up.
    """

    max_iterations: int = 60
    tolerance: float = 1e-7
    relative_tolerance: float = 1e-13
    step_tolerance: float = 1e-11
    damping: float = 1e-3
    renewal: float = 0.02
    rejections: int = 60
    worthwhile: float = 0.0
    aim: float = math.inf


@dataclass(frozen=True, eq=False)
class Found(Generic[G]):
    """End of a search: the point (p,) and the ground there (None if it could not start)."""

    point: FloatArray
    ground: G | None
    iterations: int
    reason: Stop
    evaluations: int

    @property
    def cost(self) -> float:
        return self.ground.cost if self.ground is not None else float("inf")


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
    terrain: Terrain[G],
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
    settings: LocalSettings | None = None,
    progress: Callable[[int, float], None] | None = None,
    shape: Shape | None = None,
    met: Callable[[G, FloatArray], bool] | None = None,
) -> Found[G]:
    """Descend from a start.

    Parameters
    ----------
    terrain : Terrain
    start : ndarray, shape (p,)
    low, high : ndarray, shape (p,)
        Bounds; equal ones hold a coordinate.
    settings : LocalSettings, optional
    progress : callable, optional
        Told the iteration and the cost.
    shape : Shape, optional
    met : callable, optional
        Told the ground and the step (p,) to where its quadratic model is least: whether that is known already.
    """
    settings = settings or LocalSettings()
    point = np.clip(np.asarray(start, dtype=np.float64), low, high)
    here = terrain.look(point)
    if here is None:
        return Found(point, None, 0, Stop.FAILED_START, 1)
    way = Way(low, high, shape or Shape())
    damping, growth, evaluations = settings.damping, 2.0, 1
    ceiling, rejected, idle = np.zeros(point.size), 0, 0
    lately: deque[float] = deque(maxlen=LATELY)
    for iteration in range(1, settings.max_iterations + 1):
        np.maximum(ceiling, np.diag(here.hessian), out=ceiling)
        scale = np.where(ceiling > 0.0, ceiling, 1.0)
        room = way.room(point)
        newton = bounded_step(here.hessian + np.diag(1e-10 * scale), here.gradient, *room)
        promise = here.promise(newton)
        if met is not None and met(here, newton):
            return Found(point, here, iteration, Stop.MET, evaluations)
        if len(lately) == LATELY and here.cost - settings.aim > REACH * max(sum(lately), promise):
            return Found(point, here, iteration, Stop.BEATEN, evaluations)
        end = _flat(here, promise, newton, point, settings)
        before = here.cost
        if end is None:
            step = bounded_step(here.hessian + np.diag((1e-14 + damping) * scale), here.gradient, *room)
            promised = max(here.promise(step), 1e-300)
            ahead = way.ahead(point, step)
            there = terrain.look(ahead)
            evaluations += 1
            if there is None or not there.cost < before:
                if way.turns(point, ahead, newton):
                    continue
                damping, growth, rejected = damping * growth, 2.0 * growth, rejected + 1
                if damping > 1e15 or rejected >= settings.rejections:
                    return Found(point, here, iteration, Stop.NO_PROGRESS, evaluations)
                continue
            ratio = min((before - there.cost) / promised, 1e6)  # the cube of more overflows
            damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), 1e-12)
            way.went(point, ahead, newton, ratio)
            growth, point, here, rejected = 2.0, ahead, there, 0
            if progress is not None:
                progress(iteration, here.cost)
        renewed = terrain.renew(here)
        gained, here = here.cost - renewed.cost, renewed
        lately.append(before - here.cost)
        idle = idle + 1 if before - here.cost < settings.worthwhile else 0
        if end is None and idle >= 2:
            return Found(point, here, iteration, Stop.NO_PROGRESS, evaluations)
        if end is not None and gained < settings.renewal:
            return Found(point, here, iteration, end, evaluations)
    return Found(point, here, settings.max_iterations, Stop.ITERATION_LIMIT, evaluations)


def _flat(here: Ground, promise: float, newton: FloatArray, point: FloatArray, settings: LocalSettings) -> Stop | None:
    """Whether even the best step is not worth taking."""
    # A decrease below the cost's own rounding can be promised, but not seen.
    relative = max(settings.relative_tolerance, float(np.finfo(np.float64).eps))
    if promise <= max(settings.tolerance, relative * abs(here.cost)):
        return Stop.CONVERGED
    if np.all(np.abs(newton) <= settings.step_tolerance * (np.abs(point) + settings.step_tolerance)):
        return Stop.SMALL_STEP
    return None
