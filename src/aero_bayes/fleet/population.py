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
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

FloatArray = NDArray[np.float64]
#: Fewest rigs from which a spread is inferred: with fewer its flat prior says more than they.
MIN_RIGS = 4
#: Points of the grid over τ: first over all sizes, then where the posterior is; nats below its peak that are left out.
COARSE_POINTS, FINE_POINTS, MAX_DEPTH = 160, 400, 18.0
#: Rigs that are left out at a time, which bounds the memory.
CHUNK_RIGS = 256


@dataclass(frozen=True, eq=False)
class Population:
    """Posterior of a fleet's mean and spread.

    Parameters
    ----------
    spreads : ndarray, shape (t,)
        Grid of τ.
    weights : ndarray, shape (t,)
        Posterior share of each.
    means, deviations : ndarray, shape (t,)
        μ given τ is Gaussian with these.
    """

    spreads: FloatArray
    weights: FloatArray
    means: FloatArray
    deviations: FloatArray

    def mean_quantiles(self, levels: FloatArray) -> FloatArray:
        """Quantiles of μ, shape of ``levels``."""
        return _mixture_quantiles(self.weights, self.means, self.deviations, levels)

    def spread_quantiles(self, levels: FloatArray) -> FloatArray:
        """Quantiles of τ, shape of ``levels``."""
        below = np.cumsum(self.weights) - 0.5 * self.weights
        return np.asarray(np.interp(levels, below, self.spreads))

    def next_quantiles(self, levels: FloatArray) -> FloatArray:
        """Quantiles of the next rig's value, shape of ``levels``."""
        return _mixture_quantiles(self.weights, self.means, np.hypot(self.deviations, self.spreads), levels)

    def shrunken(self, centres: FloatArray, widths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of rigs' own values in the light of the fleet, shape (n,) each."""
        mean, sd = np.empty_like(centres), np.empty_like(centres)
        variance = self.spreads**2
        for part in _chunks(len(centres)):
            own = widths[part, None] ** 2
            pull = own / (own + variance)
            at = centres[part, None] * (1.0 - pull) + pull * self.means
            within = (1.0 - pull) * own + (pull * self.deviations) ** 2
            mean[part] = at @ self.weights
            sd[part] = np.sqrt((within + at**2) @ self.weights - mean[part] ** 2)
        return mean, sd


def fit_population(centres: FloatArray, widths: FloatArray) -> Population:
    """Posterior of mean and spread.

    Parameters
    ----------
    centres, widths : ndarray, shape (n,)
        m_i and s_i; at least :data:`MIN_RIGS` rigs, widths positive.
    """
    coarse = _spreads_to_try(centres, widths)
    spreads = _where_likely(coarse, _sums(centres, widths, coarse))
    sums = _sums(centres, widths, spreads)
    return _posterior(spreads, sums)


def stand_out(centres: FloatArray, widths: FloatArray, found: Population) -> tuple[FloatArray, FloatArray]:
    """How unlikely each rig is to come from the fleet that all the others form.

    Returns
    -------
    p_values : ndarray, shape (n,)
        Two-sided, in the prediction from the other rigs.
    away : ndarray, shape (n,)
        The same as a number of standard deviations, with its sign.
    """
    # Without a rig that is far off the others may differ much less than with it.
    spreads = np.union1d(found.spreads, np.linspace(0.0, found.spreads[0], FINE_POINTS // 2))
    total = _sums(centres, widths, spreads)
    tail, above = np.empty_like(centres), np.empty_like(centres, dtype=bool)
    for part in _chunks(len(centres)):
        variance = widths[part, None] ** 2 + spreads**2
        own = _Sums.of(centres[part, None], variance)
        rest = _Sums(*(whole - one for whole, one in zip(total.parts, own.parts, strict=True)))
        log = rest.log_posterior()
        weights = np.exp(log - log.max(axis=1, keepdims=True)) * _cells(spreads)
        weights /= weights.sum(axis=1, keepdims=True)
        z = (centres[part, None] - rest.mean) / np.sqrt(variance + 1.0 / rest.precision)
        lower, upper = (np.sum(weights * ndtr(side), axis=1) for side in (z, -z))
        tail[part], above[part] = np.maximum(np.minimum(lower, upper), 1e-300), upper < lower
    return 2.0 * tail, np.where(above, -ndtri(tail), ndtri(tail))


@dataclass(frozen=True, eq=False)
class _Sums:
    """What the posterior at each τ is made of; sums over rigs, so that one rig can be taken out again."""

    precision: FloatArray
    weighted: FloatArray
    squares: FloatArray
    log_variance: FloatArray

    @classmethod
    def of(cls, centres: FloatArray, variance: FloatArray) -> _Sums:
        precision = 1.0 / variance
        return cls(precision, precision * centres, precision * centres**2, np.log(variance))

    @property
    def parts(self) -> tuple[FloatArray, ...]:
        return self.precision, self.weighted, self.squares, self.log_variance

    @property
    def mean(self) -> FloatArray:
        return self.weighted / self.precision

    def log_posterior(self) -> FloatArray:
        """Of τ up to a constant, μ integrated out."""
        misfit = self.squares - self.weighted**2 / self.precision
        return -0.5 * (self.log_variance + np.log(self.precision) + misfit)


def _sums(centres: FloatArray, widths: FloatArray, spreads: FloatArray) -> _Sums:
    total = [np.zeros(len(spreads)) for _ in range(4)]
    for part in _chunks(len(centres)):
        own = _Sums.of(centres[part, None], widths[part, None] ** 2 + spreads**2)
        for into, one in zip(total, own.parts, strict=True):
            into += one.sum(axis=0)
    return _Sums(*total)


def _posterior(spreads: FloatArray, sums: _Sums) -> Population:
    log = sums.log_posterior()
    weights = np.exp(log - log.max()) * _cells(spreads)
    return Population(spreads, weights / weights.sum(), sums.mean, sums.precision**-0.5)


def _spreads_to_try(centres: FloatArray, widths: FloatArray) -> FloatArray:
    """From none to far beyond what the rigs differ by."""
    largest = 30.0 * max(float(np.ptp(centres)), float(np.median(widths)))
    return np.concatenate([[0.0], np.geomspace(1e-6 * largest, largest, COARSE_POINTS - 1)])


def _where_likely(spreads: FloatArray, sums: _Sums) -> FloatArray:
    """A fine grid over what is not negligible; denser towards its lower end, where the density may be steep."""
    log = sums.log_posterior()
    kept = np.flatnonzero(log > log.max() - MAX_DEPTH)
    low, high = spreads[max(kept[0] - 1, 0)], spreads[min(kept[-1] + 1, len(spreads) - 1)]
    return np.asarray(low + (high - low) * np.linspace(0.0, 1.0, FINE_POINTS) ** 1.5)


def _cells(points: FloatArray) -> FloatArray:
    """Length of the axis that each grid point stands for (trapezoid rule)."""
    gaps = np.diff(points)
    return np.asarray(0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps)))


def _mixture_quantiles(weights: FloatArray, means: FloatArray, sds: FloatArray, levels: FloatArray) -> FloatArray:
    """Quantiles of a mixture of Gaussians, by bisection of its distribution function."""
    used = weights > 1e-12
    weights, means, sds = weights[used], means[used], sds[used]
    low = np.full(levels.shape, float(np.min(means - 40.0 * sds)))
    high = np.full(levels.shape, float(np.max(means + 40.0 * sds)))
    for _ in range(80):
        middle = 0.5 * (low + high)
        above = ndtr((middle[..., None] - means) / sds) @ weights > levels
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(0.5 * (low + high))


def _chunks(size: int) -> Iterator[slice]:
    for first in range(0, size, CHUNK_RIGS):
        yield slice(first, first + CHUNK_RIGS)
