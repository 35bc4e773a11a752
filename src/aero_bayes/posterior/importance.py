"""The integral of a density by importance sampling, with weights that say whether it is reliable.

Reference: Vehtari, Gelman and Gabry (2017), Stat. Comput. 27, 1413.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from aero_bayes.arrays import FloatArray
from aero_bayes.posterior.moves.warped_student_t import WarpedStudentT

#: Shape above which an estimate from smoothed weights is not to be trusted.
RELIABLE_BELOW = 0.7


@dataclass(frozen=True, eq=False)
class Evidence:
    """The logarithm of a density's integral, and the shape of the weights' tail: reliable below 0.7."""

    log_evidence: float
    pareto_k: float
    ess: float

    @property
    def reliable(self) -> bool:
        return self.pareto_k < RELIABLE_BELOW


def importance_sample(
    density: Callable[[FloatArray], FloatArray], proposal: WarpedStudentT, size: int, rng: np.random.Generator
) -> Evidence:
    """Draw from a proposal, and weigh the draws by a density."""
    points = proposal.sample(np.random.RandomState(np.random.MT19937(int(rng.integers(2**63)))), size)
    ratio = density(points) - proposal.log_density(points)
    ratio = np.where(np.isnan(ratio), -np.inf, ratio)
    if not np.isfinite(ratio).any():
        raise ValueError("the density vanishes at every draw")
    smoothed, shape = pareto_smooth(ratio)
    total = float(logsumexp(smoothed))
    return Evidence(total - math.log(size), shape, math.exp(2.0 * total - float(logsumexp(2.0 * smoothed))))


def pareto_smooth(log_weights: FloatArray) -> tuple[FloatArray, float]:
    """Replace the largest weights by the expected order statistics of the Pareto tail fitted to them."""
    n = log_weights.size
    size = int(min(0.2 * n, 3.0 * math.sqrt(n)))
    top = float(np.max(log_weights))
    if size < 5 or not math.isfinite(top):
        return log_weights, math.inf
    order = np.argsort(log_weights, kind="stable")
    tail, cutoff = order[-size:], float(log_weights[order[-size - 1]])
    threshold = math.exp(cutoff - top)
    excess = np.exp(log_weights[tail] - top) - threshold
    if not excess[0] >= 0.0 or excess[-1] <= 1e-12:
        return log_weights, 0.0
    shape, scale = _fit_pareto(np.maximum(excess, 1e-300))
    level = (np.arange(size) + 0.5) / size
    quantile = -scale * np.log1p(-level) if abs(shape) < 1e-12 else scale * np.expm1(-shape * np.log1p(-level)) / shape
    smoothed = log_weights.copy()
    smoothed[tail] = np.minimum(np.log(threshold + quantile), 0.0) + top
    return smoothed, shape


def _fit_pareto(excess: FloatArray) -> tuple[float, float]:
    """Estimate shape and scale of a generalised Pareto distribution from increasing excesses, shape (n,).

    A quasi-Bayesian mean over a grid of the likelihood's profile, with the shape shrunk a little towards one half."""
    n = excess.size
    grid = 30 + int(math.sqrt(n))
    quartile = excess[int(n / 4 + 0.5) - 1] if n >= 4 else excess[0]
    position = np.arange(1, grid + 1) - 0.5
    inverse = 1.0 / excess[-1] + (1.0 - np.sqrt(grid / position)) / (3.0 * max(float(quartile), 1e-300))
    inverse = np.where(inverse == 0.0, 1e-12, inverse)
    slope = np.mean(np.log1p(-inverse[:, None] * excess), axis=1)
    profile = n * (np.log(-inverse / slope) - slope - 1.0)
    weight = np.exp(profile - logsumexp(profile))
    best = float(weight @ inverse)
    shape = float(np.mean(np.log1p(-best * excess)))
    scale = -shape / best
    return (shape * n + 0.5 * 10.0) / (n + 10.0), scale
