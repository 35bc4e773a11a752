"""Whittle's likelihood of white plus Ornstein-Uhlenbeck noise, on a binned periodogram."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # imports its parts when they are first used
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray

#: Alternating updates of the white and the correlated variance for each correlation time of a grid.
MULTIPLICATIVE_UPDATES = 40


@dataclass(frozen=True, eq=False)
class BinnedPeriodogram:
    """Periodogram of a residual, in bins whose width grows with frequency.

    ``angular`` (k,) are mean frequencies in rad a sample, ``count`` (k,) the number of lines, ``power`` (k,) their mean
    power, and ``interval`` is the time step in s."""

    angular: FloatArray
    count: FloatArray
    power: FloatArray
    interval: float

    @classmethod
    def of(
        cls, residual: FloatArray, time: FloatArray, interval: float, even: bool, bins: int = 80
    ) -> BinnedPeriodogram:
        """Return the periodogram of a residual (n,) at times (n,) in s with median step ``interval``. Gaps are
        interpolated."""
        values = residual
        if not even:
            values = np.interp(np.arange(time[0], time[-1] + 0.5 * interval, interval), time, residual)
        n = values.size
        power = np.abs(np.fft.rfft(values)) ** 2 / n
        if n % 2 == 0:
            power = power[:-1]
        # The line at zero frequency has half the degrees of freedom of the others.
        weight = np.ones(power.size)
        weight[0] = 0.5
        weight *= residual.size / n
        line = np.arange(power.size)
        edges = np.unique(
            np.concatenate((np.arange(min(12, power.size)), np.geomspace(12, power.size, bins).astype(int)))
        )
        edges = edges[edges < power.size]
        count = np.add.reduceat(weight, edges)
        angular = 2.0 * np.pi / n * np.add.reduceat(weight * line, edges) / count
        return cls(angular, count, np.add.reduceat(weight * power, edges) / count, interval)


def maximise_whittle(
    powers: Sequence[BinnedPeriodogram], *, floor: float, longest: float, near: float | None = None
) -> tuple[float, float, float]:
    """Maximise Whittle's likelihood: ``sd_white``, ``sd_ou`` and ``tau`` in s (zero for white noise alone)."""
    spectrum = _Spectrum(
        np.cos(np.concatenate([power.angular for power in powers])),
        np.concatenate([power.count for power in powers]),
        np.concatenate([power.power for power in powers]),
        powers[0].interval,
    )
    total = spectrum.mean()
    if total <= 0.0:
        return max(floor, 1e-12), 0.0, 0.0
    smallest = max(floor**2, 1e-8 * total)
    low = np.array([math.log(smallest), math.log(1e-7 * total), math.log(0.8 * spectrum.interval)])
    high = np.array(
        [
            math.log(max(4.0 * total, 2.0 * smallest)),
            math.log(30.0 * total + 30 * smallest),
            math.log(max(longest, 4.0 * spectrum.interval)),
        ]
    )
    taus = np.geomspace(math.exp(low[2]), math.exp(high[2]), 9)
    if near is not None:
        taus = np.append(taus, np.clip(near, taus[0], taus[-1]))
    fast = np.concatenate([power.angular for power in powers]) > 1.0
    begin, cost = _best_of_grid(spectrum, taus, smallest, spectrum.mean(fast) or total)
    begin = np.clip(begin, low, high)
    found = scipy.optimize.minimize(
        spectrum.cost, begin, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 40},
    )  # fmt: skip
    white, drift, tau = np.exp(found.x if found.fun <= cost else begin)
    if drift < 1e-6 * total:
        return math.sqrt(max(total, smallest)), 0.0, 0.0
    return math.sqrt(white), math.sqrt(drift), float(tau)


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Lines of all recordings: cosine of the angle, count, power (each (n,)), and the sample interval in s."""

    cosine: FloatArray
    count: FloatArray
    observed: FloatArray
    interval: float

    def mean(self, lines: NDArray[np.bool_] | None = None) -> float:
        """Compute the mean power of the readings, or of some lines (n,); zero for none."""
        count, observed = (self.count, self.observed) if lines is None else (self.count[lines], self.observed[lines])
        return float(np.sum(count * observed) / (np.sum(count) if lines is None else max(np.sum(count), 1.0)))

    def cost(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Compute Whittle's cost and its gradient (3,), at the logarithms of the two variances and of the time (3,)."""
        white, drift, tau = math.exp(x[0]), math.exp(x[1]), math.exp(x[2])
        phi = math.exp(-self.interval / tau)
        below = 1.0 + phi * phi - 2.0 * phi * self.cosine
        shape = (1.0 - phi * phi) / below
        model = white + drift * shape
        cost = float(np.sum(self.count * (np.log(model) + self.observed / model)))
        slope = self.count * (1.0 / model - self.observed / model**2)
        by_phi = drift * (-2.0 * phi * below - (1.0 - phi * phi) * (2.0 * phi - 2.0 * self.cosine)) / below**2
        gradient = np.array(
            [
                white * np.sum(slope),
                drift * np.sum(slope * shape),
                np.sum(slope * by_phi) * phi * self.interval / tau,
            ]
        )
        return cost, gradient


def _best_of_grid(spectrum: _Spectrum, taus: FloatArray, smallest: float, fast: float) -> tuple[FloatArray, float]:
    """Return the best of a grid of correlation times (k,) in s.

    Logarithms of the variances and the time (3,), and the cost."""
    total, count = spectrum.mean(), spectrum.count
    phis = np.exp(-spectrum.interval / taus)[:, np.newaxis]
    shapes = (1.0 - phis**2) / (1.0 + phis**2 - 2.0 * phis * spectrum.cosine)
    whites = np.full((taus.size, 1), max(min(fast, total), smallest))
    drifts = np.full((taus.size, 1), max(total - fast, 0.02 * total))
    one, power = np.ones((count.size, 1)), count * spectrum.observed
    for step in range(MULTIPLICATIVE_UPDATES):
        inverse = 1.0 / (whites + drifts * shapes)
        push, pull = power * inverse * inverse, count * inverse
        # Multiplicative updates of both variances at once would overshoot.
        if step % 2:
            push, pull = push * shapes, pull * shapes
            drifts = np.maximum(drifts * ((push @ one) / (pull @ one)), 1e-7 * total)
        else:
            whites = np.maximum(whites * ((push @ one) / (pull @ one)), smallest)
    model = whites + drifts * shapes
    costs = np.sum(count * (np.log(model) + spectrum.observed / model), axis=1)
    k = int(np.argmin(costs))
    return np.log([whites[k, 0], drifts[k, 0], taus[k]]), float(costs[k])
