"""Global-best particle swarm with constriction (Clerc and Kennedy, 2002, IEEE Trans. Evol. Comput. 6, 58)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from aero_bayes.arrays import FloatArray

BatchCost = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class SwarmSettings:
    """Size and limits of a swarm.

    ``tolerance`` ends the search once the best cost improved by less than this much (in the cost's own unit) over
    ``patience`` iterations; ``target`` ends it at a cost that is good enough (the paper's epsilon_0)."""

    particles: int = 40
    iterations: int = 120
    patience: int = 25
    tolerance: float = 0.5
    target: float = -math.inf
    attraction: float = 4.1
    reflect: bool = True


@dataclass(frozen=True)
class SwarmResult:
    """Where the swarm ended.

    ``best`` has shape (d,); ``candidates`` (k, d) are each particle's own best in order of cost; ``history`` holds the
    best cost after each iteration; ``failures`` counts evaluations that gave no finite cost."""

    JSON_KEYS: ClassVar = "evaluations history failures reason"

    best: FloatArray
    cost: float
    candidates: FloatArray
    costs: FloatArray
    history: FloatArray
    evaluations: int
    failures: int
    reason: str


class Swarm:
    """A swarm that is asked for positions and told their costs, so that a batch is evaluated in one call."""

    def __init__(
        self,
        low: FloatArray,
        high: FloatArray,
        rng: np.random.Generator,
        settings: SwarmSettings,
        start: FloatArray | None = None,
    ) -> None:
        self._low, self._high, self._rng, self._settings = low, high, rng, settings
        n, d = settings.particles, low.size
        cells = np.stack([rng.permutation(n) for _ in range(d)], axis=1)
        self.position = low + (cells + rng.random((n, d))) / n * (high - low)
        if start is not None:
            self.position[: len(start)] = np.clip(start[:n], low, high)
        self._velocity = (rng.random((n, d)) - 0.5) * 0.5 * (high - low)
        self.own = self.position.copy()
        self.own_cost = np.full(n, np.inf)
        phi = settings.attraction
        self._constriction = 2.0 / abs(2.0 - phi - math.sqrt(phi * phi - 4.0 * phi))

    @property
    def best(self) -> int:
        """Index of the particle that holds the best position."""
        return int(np.argmin(self.own_cost))

    def ask(self) -> FloatArray:
        """Return positions to evaluate, shape (particles, d)."""
        return self.position

    def tell(self, cost: FloatArray) -> None:
        """Take the costs of the positions asked for (not finite: failed) and move on."""
        cost = np.where(np.isfinite(cost), cost, np.inf)
        better = cost < self.own_cost
        self.own[better], self.own_cost[better] = self.position[better], cost[better]
        n, d = self.position.shape
        half = 0.5 * self._settings.attraction
        own, social = half * self._rng.random((2, n, d))
        pull = own * (self.own - self.position) + social * (self.own[self.best] - self.position)
        self._velocity = self._constriction * (self._velocity + pull)
        limit = 0.5 * (self._high - self._low)
        self._velocity = np.clip(self._velocity, -limit, limit)
        self.position = self._contain(self.position + self._velocity)

    def _contain(self, position: FloatArray) -> FloatArray:
        outside = (position < self._low) | (position > self._high)
        inside = np.clip(position, self._low, self._high)
        if self._settings.reflect:
            inside = np.clip(2.0 * inside - position, self._low, self._high)
        self._velocity[outside] *= -0.5
        return inside


def minimise(
    cost: BatchCost,
    low: FloatArray,
    high: FloatArray,
    rng: np.random.Generator,
    settings: SwarmSettings | None = None,
    start: FloatArray | None = None,
    on_iteration: Callable[[int, float], object] | None = None,
) -> SwarmResult:
    """Search a box for the smallest cost."""
    settings = settings or SwarmSettings()
    swarm = Swarm(low, high, rng, settings, start)
    history: list[float] = []
    failures, reason = 0, "the iteration limit was reached"
    for iteration in range(settings.iterations):
        values = np.asarray(cost(swarm.ask()), dtype=np.float64)
        failures += int(np.sum(~np.isfinite(values)))
        swarm.tell(values)
        history.append(float(swarm.own_cost.min()))
        if on_iteration is not None and on_iteration(iteration, history[-1]) is True:
            reason = "it was interrupted"
            break
        if history[-1] <= settings.target:
            reason = "the cost fell below the target"
            break
        past = history[-1 - settings.patience] if iteration >= settings.patience else math.inf
        if math.isfinite(past) and past - history[-1] < settings.tolerance:
            reason = "the best cost no longer improved"
            break
    order = np.argsort(swarm.own_cost, kind="stable")
    return SwarmResult(
        swarm.own[order[0]], float(swarm.own_cost[order[0]]), swarm.own[order], swarm.own_cost[order],
        np.array(history), len(history) * settings.particles, failures, reason,
    )  # fmt: skip
