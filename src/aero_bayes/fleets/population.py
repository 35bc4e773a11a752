"""Mean and spread of a parameter over the fleet, from the estimate of each rig (random-effects meta-analysis).

Rig i has the value θ_i ~ N(μ, τ²); its data say m_i ~ N(θ_i, s_i²), so that m_i ~ N(μ, s_i² + τ²) with θ_i summed out.
With a flat prior on μ this is Gaussian in μ at any τ, and what is left is one dimension, τ ≥ 0 with a flat prior (of
the spread itself; of its logarithm it would be improper at zero). It is done by quadrature: no chain, no seed, and no
trouble at small τ, where a sampler of (μ, τ, θ) gets stuck. (Gelman et al., Bayesian Data Analysis, section 5.4.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from aero_bayes.arrays import FloatArray

#: Fewest rigs from which a spread is inferred: with fewer its flat prior says more than they.
MIN_RIGS = 4
#: Points of the grid over τ: first over all sizes, then where the posterior is; nats below its peak that are left out.
COARSE_POINTS, FINE_POINTS, MAX_DEPTH = 160, 400, 18.0
#: Rigs that are worked on at a time, which bounds the memory.
CHUNK_RIGS = 256


@dataclass(frozen=True, eq=False)
class Population:
    """Posterior of a fleet's mean and spread."""

    spreads: FloatArray
    weights: FloatArray
    means: FloatArray
    deviations: FloatArray

    def mean_quantiles(self, levels: FloatArray) -> FloatArray:
        """Compute quantiles of μ, shape of ``levels``."""
        return self._quantiles(self.deviations, levels)

    def spread_quantiles(self, levels: FloatArray) -> FloatArray:
        """Compute quantiles of τ, shape of ``levels``."""
        return np.asarray(np.interp(levels, np.cumsum(self.weights) - 0.5 * self.weights, self.spreads))

    def next_quantiles(self, levels: FloatArray) -> FloatArray:
        """Compute quantiles of the next rig's value, shape of ``levels``."""
        return self._quantiles(np.hypot(self.deviations, self.spreads), levels)

    def shrunken(self, centres: FloatArray, widths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute mean and standard deviation of rigs' values in the light of the fleet, shape (n,) each."""
        mean, sd = np.empty_like(centres), np.empty_like(centres)
        for part in _chunks(len(centres)):
            variance = widths[part, None] ** 2
            pull = variance / (variance + self.spreads**2)
            given = centres[part, None] * (1.0 - pull) + pull * self.means
            within = (1.0 - pull) * variance + (pull * self.deviations) ** 2
            mean[part] = given @ self.weights
            sd[part] = np.sqrt((within + given**2) @ self.weights - mean[part] ** 2)
        return mean, sd

    def _quantiles(self, deviations: FloatArray, levels: FloatArray) -> FloatArray:
        """Compute quantiles of a mixture of Gaussians over the grid, by bisection of its distribution function."""
        used = self.weights > 1e-12
        weights, means, sds = self.weights[used], self.means[used], deviations[used]
        low, high = (np.full(levels.shape, end) for end in (np.min(means - 40.0 * sds), np.max(means + 40.0 * sds)))
        for _ in range(80):
            middle = 0.5 * (low + high)
            above = ndtr((middle[..., None] - means) / sds) @ weights > levels
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return np.asarray(0.5 * (low + high))


def fit_population(centres: FloatArray, widths: FloatArray) -> Population:
    """Compute the posterior of mean and spread from m_i and s_i > 0 of at least :data:`MIN_RIGS` rigs, shape (n,)."""
    largest = 30.0 * max(float(np.ptp(centres)), float(np.median(widths)))
    coarse = np.append(0.0, np.geomspace(1e-6 * largest, largest, COARSE_POINTS - 1))
    log = _log_posterior(_sums(centres, widths, coarse))
    kept = np.flatnonzero(log > log.max() - MAX_DEPTH)
    low, high = coarse[max(kept[0] - 1, 0)], coarse[min(kept[-1] + 1, len(coarse) - 1)]
    # Denser towards the lower end, where the density may be steep.
    spreads = low + (high - low) * np.linspace(0.0, 1.0, FINE_POINTS) ** 1.5
    sums = _sums(centres, widths, spreads)
    return Population(spreads, _weights(_log_posterior(sums), spreads), sums[1] / sums[0], sums[0] ** -0.5)


def stand_out(centres: FloatArray, widths: FloatArray, population: Population) -> tuple[FloatArray, FloatArray]:
    """Tell how unlikely each rig is to come from the fleet that all the others form."""
    # Without a rig that is far off the others may differ much less than with it.
    spreads = np.union1d(population.spreads, np.linspace(0.0, population.spreads[0], FINE_POINTS // 2))
    total = _sums(centres, widths, spreads)
    tail, above = np.empty_like(centres), np.empty_like(centres, dtype=bool)
    for part in _chunks(len(centres)):
        rest = total[:, None] - _terms(centres[part], widths[part], spreads)
        weights = _weights(_log_posterior(rest), spreads)
        variance = widths[part, None] ** 2 + spreads**2 + 1.0 / rest[0]
        z = (centres[part, None] - rest[1] / rest[0]) / np.sqrt(variance)
        lower, upper = (np.sum(weights * ndtr(side), axis=1) for side in (z, -z))
        tail[part], above[part] = np.maximum(np.minimum(lower, upper), 1e-300), upper < lower
    return 2.0 * tail, np.where(above, -ndtri(tail), ndtri(tail))


def _terms(centres: FloatArray, widths: FloatArray, spreads: FloatArray) -> FloatArray:
    """Compute each rig's part of what the posterior at each τ is made of, shape (4, n, t).

    They are summed over rigs, so that one rig can be taken out again: the precision, precision times centre, precision
    times centre squared, and the logarithm of the variance."""
    variance, centre = widths[:, None] ** 2 + spreads**2, centres[:, None]
    return np.stack([1.0 / variance, centre / variance, centre**2 / variance, np.log(variance)])


def _sums(centres: FloatArray, widths: FloatArray, spreads: FloatArray) -> FloatArray:
    total = np.zeros((4, len(spreads)))
    for part in _chunks(len(centres)):
        total += _terms(centres[part], widths[part], spreads).sum(axis=1)
    return total


def _log_posterior(sums: FloatArray) -> FloatArray:
    """Compute the log-posterior of τ up to a constant, μ integrated out."""
    precision, weighted, squares, log_variance = sums
    return np.asarray(-0.5 * (log_variance + np.log(precision) + squares - weighted**2 / precision))


def _weights(log: FloatArray, spreads: FloatArray) -> FloatArray:
    """Compute the share of each grid point by the trapezoid rule, along the last axis."""
    gaps = np.diff(spreads)
    weights = np.exp(log - log.max(axis=-1, keepdims=True)) * (np.append(gaps, 0.0) + np.append(0.0, gaps))
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))


def _chunks(size: int) -> Iterator[slice]:
    for first in range(0, size, CHUNK_RIGS):
        yield slice(first, first + CHUNK_RIGS)
