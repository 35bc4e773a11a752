"""How well a model predicts: WAIC, leave-one-out and leave-future-out over blocks of time, in order.

Single samples of a recording predict each other through correlated noise, so the unit here is a block that is long
against it, and its density is always given what came before. References: Watanabe (2010), JMLR 11, 3571; Vehtari,
Gelman and Gabry (2017), Stat. Comput. 27, 1413; Buerkner, Gabry and Vehtari (2020), J. Stat. Comput. Simul. 90, 2499.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.plain import picked
from aero_bayes.posterior.importance import RELIABLE_BELOW, pareto_smooth

#: Densities (s, b) of all blocks over draws of the posterior that has seen only the first so many blocks.
Refit = Callable[[int], FloatArray]


@dataclass(frozen=True, eq=False)
class ElpdEstimate:
    """Expected log-density of unseen blocks."""

    method: str
    elpd: float
    pointwise: FloatArray
    parameters: float
    pareto_k: FloatArray
    refits: int = 0

    @property
    def se(self) -> float:
        """Standard error of ``elpd`` over blocks."""
        n = self.pointwise.size
        return float(math.sqrt(n * np.var(self.pointwise, ddof=1))) if n > 1 else math.inf

    @property
    def reliable(self) -> bool:
        return bool(np.all(self.pareto_k < RELIABLE_BELOW))

    def to_dict(self) -> dict[str, object]:
        k_max = float(np.max(self.pareto_k))
        return picked(
            self, "method elpd se parameters reliable refits", stretches=self.pointwise.size, pareto_k_max=k_max
        )


def waic(densities: FloatArray) -> ElpdEstimate:
    """Compute Watanabe's criterion from log-densities of blocks (s, b) over posterior draws."""
    count = len(densities)
    lppd = logsumexp(densities, axis=0) - math.log(count)
    penalty = np.var(densities, axis=0, ddof=1)
    part = lppd - penalty
    # A variance above 0.4 is where Vehtari et al. stop trusting it; put on the scale of k.
    return ElpdEstimate("waic", float(part.sum()), part, float(penalty.sum()), np.where(penalty > 0.4, 1.0, 0.0))


def leave_one_out(densities: FloatArray) -> ElpdEstimate:
    """Return each block predicted from all others, by importance sampling from the posterior draws (s, b).

    What is left out is the factor of the block given what came before it."""
    smoothed, shape = _weights(-densities)
    part = logsumexp(smoothed + densities, axis=0)
    lppd = logsumexp(densities, axis=0) - math.log(len(densities))
    return ElpdEstimate("leave-one-out", float(part.sum()), part, float(np.sum(lppd - part)), shape)


def leave_future_out(densities: FloatArray, first: int, refit: Refit | None = None) -> ElpdEstimate:
    """Return each block from the ``first``-th on predicted from those before it only.

    From the last block backwards the draws are re-weighted so that they forget it; where the weights become
    unreliable, ``refit`` gives draws of the posterior that has seen only the blocks before."""
    count = densities.shape[1]
    if not 0 < first < count:
        raise InputError(f"{first} of {count} blocks to learn from leave nothing to predict")
    known, draws, refits = count, densities, 0
    part, shapes = np.empty(count - first), np.empty(count - first)
    for b in range(count - 1, first - 1, -1):
        smoothed, shape = _weights(-draws[:, b:known].sum(axis=1, keepdims=True))
        if shape[0] > RELIABLE_BELOW and refit is not None:
            draws, known, refits = refit(b), b, refits + 1
            smoothed, shape = np.full((len(draws), 1), -math.log(len(draws))), np.zeros(1)
        part[b - first], shapes[b - first] = logsumexp(smoothed[:, 0] + draws[:, b]), shape[0]
    return ElpdEstimate("leave-future-out", float(part.sum()), part, math.nan, shapes, refits)


def _weights(log_ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute smoothed and normalised log-weights of each column (s, b), and their tail shapes (b,)."""
    smoothed, shapes = np.empty(log_ratio.shape), np.empty(log_ratio.shape[1])
    for b, column in enumerate(log_ratio.T):
        usable = np.where(np.isfinite(column), column, -np.inf)
        one, shapes[b] = pareto_smooth(usable)
        smoothed[:, b] = one - logsumexp(one)
    return smoothed, shapes
