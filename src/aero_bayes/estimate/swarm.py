"""Global-best particle swarm with constriction (Clerc and Kennedy, 2002, IEEE Trans. Evol. Comput. 6, 58)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from aero_bayes.arguments import Count, NotNegative
from aero_bayes.arrays import FloatArray
from aero_bayes.plain import INTERNAL, Numbers

BatchCost = Callable[[FloatArray], FloatArray]

#: Sum of the largest pulls to a particle's own best and to that of all, and the factor with which they converge.
ATTRACTION = 4.1
CONSTRICTION = 2.0 / abs(2.0 - ATTRACTION - math.sqrt(ATTRACTION * ATTRACTION - 4.0 * ATTRACTION))


@dataclass(frozen=True)
class SwarmSettings:
    """Size and limits of a swarm.

    ``tolerance`` ends the search once the best cost improved by less than this much (in the cost's own unit) over
    ``patience`` iterations."""

    particles: Count = 40
    iterations: Count = 120
    patience: int = 25
    tolerance: NotNegative = 0.5


@dataclass(frozen=True, kw_only=True)
class SwarmSummary:
    """The particle swarm: best cost after each iteration; ``failures`` are evaluations that gave no finite cost."""

    evaluations: int
    history: Numbers
    failures: int = 0
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class SwarmResult(SwarmSummary):
    """Where the swarm ended.

    ``best`` has shape (d,); ``candidates`` (k, d) are each particle's own best in order of cost."""

    best: FloatArray = field(metadata=INTERNAL)
    cost: float = field(metadata=INTERNAL)
    candidates: FloatArray = field(metadata=INTERNAL)
    costs: FloatArray = field(metadata=INTERNAL)


def latin_hypercube(count: int, size: int, rng: np.random.Generator) -> FloatArray:
    """Draw points of the unit cube, one in each of ``count`` layers of each axis, shape (count, size)."""
    cells = np.stack([rng.permutation(count) for _ in range(size)], axis=1)
    return np.asarray((cells + rng.random((count, size))) / count)


def minimise(
    cost: BatchCost,
    low: FloatArray,
    high: FloatArray,
    rng: np.random.Generator,
    settings: SwarmSettings | None = None,
    start: FloatArray | None = None,
    on_iteration: Callable[[int, float], object] | None = None,
) -> SwarmResult:
    """Search a box for the smallest cost; a batch of positions (particles, d) is evaluated in one call."""
    settings = settings or SwarmSettings()
    n, d = settings.particles, low.size
    position = low + latin_hypercube(n, d, rng) * (high - low)
    if start is not None:
        position[: len(start)] = np.clip(start[:n], low, high)
    velocity = (rng.random((n, d)) - 0.5) * 0.5 * (high - low)
    own, own_cost = position.copy(), np.full(n, np.inf)
    history: list[float] = []
    failures, reason = 0, "the iteration limit was reached"
    for iteration in range(settings.iterations):
        values = np.asarray(cost(position), dtype=np.float64)
        failures += int(np.sum(~np.isfinite(values)))
        values = np.where(np.isfinite(values), values, np.inf)
        better = values < own_cost
        own[better], own_cost[better] = position[better], values[better]
        to_own, to_best = 0.5 * ATTRACTION * rng.random((2, n, d))
        pull = to_own * (own - position) + to_best * (own[np.argmin(own_cost)] - position)
        velocity = np.clip(CONSTRICTION * (velocity + pull), -0.5 * (high - low), 0.5 * (high - low))
        position = position + velocity
        outside = (position < low) | (position > high)
        position = np.clip(2.0 * np.clip(position, low, high) - position, low, high)
        velocity[outside] *= -0.5
        history.append(float(own_cost.min()))
        if on_iteration is not None and on_iteration(iteration, history[-1]) is True:
            reason = "it was interrupted"
            break
        past = history[-1 - settings.patience] if iteration >= settings.patience else math.inf
        if math.isfinite(past) and past - history[-1] < settings.tolerance:
            reason = "the best cost no longer improved"
            break
    order = np.argsort(own_cost, kind="stable")
    return SwarmResult(
        best=own[order[0]], cost=float(own_cost[order[0]]), candidates=own[order], costs=own_cost[order],
        history=np.array(history), evaluations=len(history) * settings.particles, failures=failures, reason=reason,
    )  # fmt: skip
