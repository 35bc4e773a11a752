"""Mean and spread of a parameter over the fleet, from the estimate of each rig (random-effects meta-analysis).

Rig i has the value θ_i ~ N(μ, τ²); its data say m_i ~ N(θ_i, s_i²), so that m_i ~ N(μ, s_i² + τ²) with θ_i summed out.
With a flat prior on μ this is Gaussian in μ at any τ, and what is left is one dimension, τ ≥ 0 with a flat prior (of
the spread itself; of its logarithm it would be improper at zero). It is done by quadrature: no chain, no seed, and no
trouble at small τ, where a sampler of (μ, τ, θ) gets stuck. (Gelman et al., Bayesian Data Analysis, section 5.4.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from aero_bayes.arrays import FloatArray

#: Fewest rigs from which a spread is inferred: with fewer its flat prior says more than they.
MIN_RIGS = 4
#: Points of the grid over τ, zero and steps of 3 % from the smallest to the largest in units of what is seen.
GRID_POINTS, SMALLEST, LARGEST = 600, 1e-6, 30.0


@dataclass(frozen=True, eq=False)
class Population:
    """Posterior of a fleet's mean and spread: τ with its weights, and mean and standard deviation of μ given each."""

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

    def given_all(self, centre: float, width: float) -> tuple[float, float]:
        """Compute mean and standard deviation of a rig's value in the light of the fleet."""
        pull = width**2 / (width**2 + self.spreads**2)
        given = centre * (1.0 - pull) + pull * self.means
        within = (1.0 - pull) * width**2 + (pull * self.deviations) ** 2
        mean = float(given @ self.weights)
        return mean, float(np.sqrt(within @ self.weights + (given - mean) ** 2 @ self.weights))

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
    size = max(float(np.ptp(centres)), float(np.median(widths)))
    spreads = np.append(0.0, size * np.geomspace(SMALLEST, LARGEST, GRID_POINTS))
    terms = [_terms(m, s, spreads) for m, s in zip(centres, widths, strict=True)]
    return _population(np.sum(terms, axis=0), spreads)


def stand_out(centres: FloatArray, widths: FloatArray, population: Population) -> tuple[FloatArray, FloatArray]:
    """Tell how unlikely each rig is to come from the fleet that all the others form: p-values, and how many sd away."""
    spreads = population.spreads
    total = sum(_terms(m, s, spreads) for m, s in zip(centres, widths, strict=True))
    tail, away = np.empty_like(centres), np.empty_like(centres)
    for k, (m, s) in enumerate(zip(centres, widths, strict=True)):
        others = _population(total - _terms(m, s, spreads), spreads)
        z = (m - others.means) / np.sqrt(s**2 + spreads**2 + others.deviations**2)
        lower, upper = (float(others.weights @ ndtr(side)) for side in (z, -z))
        tail[k] = max(min(lower, upper), 1e-300)
        away[k] = -ndtri(tail[k]) if upper < lower else ndtri(tail[k])
    return 2.0 * tail, away


def _terms(centre: float, width: float, spreads: FloatArray) -> FloatArray:
    """Compute a rig's part of the sums over rigs that the posterior at each τ is made of, shape (4, t)."""
    variance = width**2 + spreads**2
    return np.stack([1.0 / variance, centre / variance, centre**2 / variance, np.log(variance)])


def _population(sums: FloatArray, spreads: FloatArray) -> Population:
    """Integrate μ out at each τ, and weigh the grid by the trapezoid rule."""
    precision, weighted, squares, log_variance = sums
    log = -0.5 * (log_variance + np.log(precision) + squares - weighted**2 / precision)
    gaps = np.diff(spreads)
    weights = np.exp(log - log.max()) * (np.append(gaps, 0.0) + np.append(0.0, gaps))
    return Population(spreads, weights / weights.sum(), weighted / precision, precision**-0.5)
