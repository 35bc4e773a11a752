"""Whittle's likelihood of white plus Ornstein-Uhlenbeck noise, on a binned periodogram."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # imports its parts when they are first used
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Alternating updates of the white and the correlated variance for each correlation time of a grid.
MULTIPLICATIVE_UPDATES = 40


@dataclass(frozen=True, eq=False)
class BinnedPeriodogram:
    """Periodogram of a residual, in bins whose width grows with frequency.

    ``angular`` (k,) are mean frequencies in rad a sample, ``count`` (k,) the number of lines, ``power`` (k,) their mean
    power, and ``interval`` is the time step in s.
    """

    angular: FloatArray
    count: FloatArray
    power: FloatArray
    interval: float

    @classmethod
    def of(
        cls, residual: FloatArray, time: FloatArray, interval: float, even: bool, bins: int = 80
    ) -> BinnedPeriodogram:
        """The periodogram of a residual (n,) at times (n,) in s with median step ``interval``. Gaps are
        interpolated.
        """
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
    """Maximise Whittle's likelihood: ``sd_white``, ``sd_ou`` and ``tau`` in s (zero for white noise alone).

    Parameters
    ----------
    powers : sequence of BinnedPower
        One a recording; all share the noise.
    floor : float
        Least standard deviation of the white part.
    longest : float
        Greatest correlation time in s.
    near : float, optional
        A further correlation time to start from.
    """
    angular = np.concatenate([power.angular for power in powers])
    count = np.concatenate([power.count for power in powers])
    observed = np.concatenate([power.power for power in powers])
    interval = powers[0].interval
    total = float(np.sum(count * observed) / np.sum(count))
    if total <= 0.0:
        return max(floor, 1e-12), 0.0, 0.0
    smallest = max(floor**2, 1e-8 * total)
    half = angular > 1.0
    fast = float(np.sum(count[half] * observed[half]) / max(np.sum(count[half]), 1.0)) or total
    cosine = np.cos(angular)
    low = np.array([math.log(smallest), math.log(1e-7 * total), math.log(0.8 * interval)])
    high = np.array(
        [
            math.log(max(4.0 * total, 2.0 * smallest)),
            math.log(30.0 * total + 30 * smallest),
            math.log(max(longest, 4.0 * interval)),
        ]
    )

    def objective(x: FloatArray) -> tuple[float, FloatArray]:
        white, drift, tau = math.exp(x[0]), math.exp(x[1]), math.exp(x[2])
        phi = math.exp(-interval / tau)
        below = 1.0 + phi * phi - 2.0 * phi * cosine
        shape = (1.0 - phi * phi) / below
        model = white + drift * shape
        cost = float(np.sum(count * (np.log(model) + observed / model)))
        slope = count * (1.0 / model - observed / model**2)
        by_phi = drift * (-2.0 * phi * below - (1.0 - phi * phi) * (2.0 * phi - 2.0 * cosine)) / below**2
        gradient = np.array(
            [
                white * np.sum(slope),
                drift * np.sum(slope * shape),
                np.sum(slope * by_phi) * phi * interval / tau,
            ]
        )
        return cost, gradient

    # The cost has several local optima, so both variances are first found for each correlation time of a grid, all at
    # once, by the monotone multiplicative updates of Itakura-Saito factorisation (Fevotte, Bertin & Durrieu 2009).
    taus = np.geomspace(math.exp(low[2]), math.exp(high[2]), 9)
    if near is not None:
        taus = np.append(taus, np.clip(near, taus[0], taus[-1]))
    phis = np.exp(-interval / taus)[:, np.newaxis]
    shapes = (1.0 - phis**2) / (1.0 + phis**2 - 2.0 * phis * cosine)
    whites = np.full((taus.size, 1), max(min(fast, total), smallest))
    drifts = np.full((taus.size, 1), max(total - fast, 0.02 * total))
    one, power = np.ones((count.size, 1)), count * observed
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
    costs = np.sum(count * (np.log(model) + observed / model), axis=1)
    k = int(np.argmin(costs))
    begin = np.clip(np.log([whites[k, 0], drifts[k, 0], taus[k]]), low, high)
    found = scipy.optimize.minimize(
        objective, begin, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 40},
    )  # fmt: skip
    best = found.x if found.fun <= costs[k] else begin
    white, drift, tau = np.exp(best)
    if drift < 1e-6 * total:
        return math.sqrt(max(total, smallest)), 0.0, 0.0
    return math.sqrt(white), math.sqrt(drift), float(tau)
