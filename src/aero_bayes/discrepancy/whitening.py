"""White plus Ornstein-Uhlenbeck noise: its innovations filter and its estimate from residuals.

On a uniform grid the noise is an ARMA(1, 1) process; the scalar Kalman filter that whitens it settles after a few
samples and is then a linear filter with constant coefficients, which many columns (a residual and all its
sensitivities) pass through at once. Gaps and uneven samples start a new stretch of the same filter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]

_EVEN = 1e-3
_SETTLED = 1e-6


@dataclass(frozen=True)
class OutputNoise:
    """Noise of one output: white of sd ``white``, and a process of sd ``drift`` and correlation time ``tau`` (s)."""

    white: float
    drift: float = 0.0
    tau: float = 0.0

    @property
    def sd(self) -> float:
        """Standard deviation of a single reading."""
        return math.hypot(self.white, self.drift)

    def rho(self, interval: float) -> float:
        """Correlation of two readings ``interval`` s apart."""
        if self.drift == 0.0 or self.tau == 0.0:
            return 0.0
        return self.drift**2 / self.sd**2 * math.exp(-interval / self.tau)

    def triple(self) -> tuple[float, float, float]:
        """As the simulators take it."""
        return (self.white, self.drift, self.tau)


@dataclass(frozen=True, eq=False)
class Sampling:
    """When one output of one recording was read.

    ``index`` are the samples that hold a reading, ``starts`` the positions in it where an even stretch begins, and
    ``lead`` the time since the reading before (infinite for the first).
    """

    index: NDArray[np.int_]
    time: FloatArray
    interval: float
    starts: NDArray[np.int_]

    @classmethod
    def of(cls, time: FloatArray, values: FloatArray) -> Sampling:
        """Sampling of ``values`` (n,), NaN where there is no reading."""
        index = np.flatnonzero(np.isfinite(values))
        seen = time[index]
        if seen.size < 2:
            return cls(index, seen, 1.0, np.zeros(min(1, seen.size), dtype=int))
        steps = np.diff(seen)
        interval = float(np.median(steps))
        uneven = np.abs(steps - interval) > max(_EVEN * interval, 1e-9)
        return cls(index, seen, interval, np.concatenate(([0], np.flatnonzero(uneven) + 1)))

    @property
    def size(self) -> int:
        return int(self.index.size)


def whiten(columns: FloatArray, sampling: Sampling, noise: OutputNoise) -> tuple[FloatArray, float]:
    """Innovations of each row in units of their standard deviation, and the log-determinant of the covariance.

    Parameters
    ----------
    columns : ndarray, shape (k, n)
        Rows to whiten, at the readings of ``sampling``.
    sampling : Sampling
    noise : OutputNoise

    Returns
    -------
    ndarray, shape (k, n)
        With covariance C of the noise and its factor C = L L', these are L^-1 times the rows.
    float
        log det C.
    """
    n = columns.shape[1]
    if n == 0:
        return columns, 0.0
    if noise.drift == 0.0 or noise.tau == 0.0:
        return columns / noise.white, 2.0 * n * math.log(noise.white)
    r, p0 = noise.white**2, noise.drift**2
    phi = math.exp(-sampling.interval / noise.tau)
    q = -p0 * math.expm1(-2.0 * sampling.interval / noise.tau)
    half = 0.5 * (r * (1.0 - phi * phi) - q)
    settled = -half + math.sqrt(half * half + q * r)
    out = np.empty_like(columns)
    log_det = 0.0
    state = np.zeros(columns.shape[0])
    p = p0
    stops = np.append(sampling.starts[1:], n)
    for start, stop in zip(sampling.starts, stops, strict=True):
        if start > 0:
            lead = float(sampling.time[start] - sampling.time[start - 1])
            # `state` and `p` stand one even step after the last reading; move them on by the rest of the gap.
            rest = math.exp(-(lead - sampling.interval) / noise.tau)
            state, p = state * rest, max(p0 + (p - p0) * rest * rest, 0.0)
        t = int(start)
        while t < stop and abs(p - settled) > _SETTLED * (settled + r):
            s = p + r
            root = math.sqrt(s)
            innovation = columns[:, t] - state
            out[:, t] = innovation / root
            log_det += math.log(s)
            gain = p / s
            state = phi * (state + gain * innovation)
            p = phi * phi * p * (1.0 - gain) + q
            t += 1
        if t < stop:
            s = settled + r
            gain = settled / s
            stretch = columns[:, t:stop]
            expected, last = lfilter(
                [0.0, phi * gain], [1.0, -phi * (1.0 - gain)], stretch, axis=1, zi=state[:, np.newaxis]
            )
            out[:, t:stop] = (stretch - expected) / math.sqrt(s)
            log_det += (stop - t) * math.log(s)
            state, p = last[:, 0], settled
    return out, log_det


def log_likelihood(whitened: FloatArray, log_det: float) -> float:
    """Gaussian log-density of a residual from its innovations, shape (n,), and the log-determinant."""
    return -0.5 * (float(whitened @ whitened) + log_det + whitened.size * math.log(2.0 * math.pi))


def spectrum(noise: OutputNoise, interval: float, angular: FloatArray) -> FloatArray:
    """Power of one sampled value by angular frequency (rad a sample), so that white noise gives its variance."""
    if noise.drift == 0.0 or noise.tau == 0.0:
        return np.full(angular.shape, noise.white**2)
    phi = math.exp(-interval / noise.tau)
    drift = -(noise.drift**2) * math.expm1(-2.0 * interval / noise.tau)
    return noise.white**2 + drift / (1.0 + phi * phi - 2.0 * phi * np.cos(angular))


@dataclass(frozen=True, eq=False)
class BinnedPower:
    """Periodogram of a residual in bins that grow with frequency: what Whittle's likelihood needs of it."""

    angular: FloatArray
    count: FloatArray
    power: FloatArray
    interval: float

    @classmethod
    def of(cls, residual: FloatArray, sampling: Sampling, bins: int = 80) -> BinnedPower:
        """From the readings of one output; short gaps are bridged by straight lines."""
        values = residual
        if sampling.starts.size > 1:
            grid = np.arange(sampling.time[0], sampling.time[-1] + 0.5 * sampling.interval, sampling.interval)
            values = np.interp(grid, sampling.time, residual)
        n = values.size
        power = np.abs(np.fft.rfft(values)) ** 2 / n
        if n % 2 == 0:
            power = power[:-1]
        # The mean carries half the freedom of the other lines.
        weight = np.ones(power.size)
        weight[0] = 0.5
        weight *= sampling.size / n
        line = np.arange(power.size)
        edges = np.unique(
            np.concatenate((np.arange(min(12, power.size)), np.geomspace(12, power.size, bins).astype(int)))
        )
        edges = edges[edges < power.size]
        count = np.add.reduceat(weight, edges)
        angular = 2.0 * np.pi / n * np.add.reduceat(weight * line, edges) / count
        return cls(angular, count, np.add.reduceat(weight * power, edges) / count, sampling.interval)


def estimate_noise(
    powers: Sequence[BinnedPower], *, floor: float = 0.0, longest: float = 10.0, start: OutputNoise | None = None
) -> OutputNoise:
    """Noise of one output that makes its residuals likeliest (Whittle's approximation).

    Parameters
    ----------
    powers : sequence of BinnedPower
        One a recording; all share the noise.
    floor : float
        Least standard deviation of the white part, such as a sensor's quantum over the square root of twelve.
    longest : float
        Greatest correlation time in s.
    start : OutputNoise, optional
        Where to begin; tried beside a few standard places.
    """
    angular = np.concatenate([power.angular for power in powers])
    count = np.concatenate([power.count for power in powers])
    observed = np.concatenate([power.power for power in powers])
    interval = powers[0].interval
    total = float(np.sum(count * observed) / np.sum(count))
    if total <= 0.0:
        return OutputNoise(max(floor, 1e-12))
    smallest = max(floor**2, 1e-8 * total)
    half = angular > 1.0
    fast = float(np.sum(count[half] * observed[half]) / max(np.sum(count[half]), 1.0)) or total
    cosine = np.cos(angular)
    low = np.array([math.log(smallest), math.log(1e-7 * total), math.log(1.5 * interval)])
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

    # The cost has several valleys: white and drift are first found for each of a row of correlation times, all at once,
    # by the monotone multiplicative updates of Itakura-Saito factorisation (Fevotte, Bertin & Durrieu 2009).
    taus = np.geomspace(math.exp(low[2]), math.exp(high[2]), 9)
    if start is not None and start.drift > 0.0 and start.tau > 0.0:
        taus = np.append(taus, np.clip(start.tau, taus[0], taus[-1]))
    phis = np.exp(-interval / taus)[:, np.newaxis]
    shapes = (1.0 - phis**2) / (1.0 + phis**2 - 2.0 * phis * cosine)
    whites = np.full((taus.size, 1), max(min(fast, total), smallest))
    drifts = np.full((taus.size, 1), max(total - fast, 0.02 * total))
    for _ in range(40):
        model = whites + drifts * shapes
        push, pull = count * observed / model**2, count / model
        whites = np.maximum(whites * np.sum(push, 1, keepdims=True) / np.sum(pull, 1, keepdims=True), smallest)
        model = whites + drifts * shapes
        push, pull = count * observed / model**2 * shapes, count / model * shapes
        drifts = np.maximum(drifts * np.sum(push, 1, keepdims=True) / np.sum(pull, 1, keepdims=True), 1e-7 * total)
    model = whites + drifts * shapes
    costs = np.sum(count * (np.log(model) + observed / model), axis=1)
    k = int(np.argmin(costs))
    begin = np.clip(np.log([whites[k, 0], drifts[k, 0], taus[k]]), low, high)
    found = minimize(
        objective, begin, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 40},
    )  # fmt: skip
    best = found.x if found.fun <= costs[k] else begin
    white, drift, tau = np.exp(best)
    if drift < 1e-6 * total:
        return OutputNoise(math.sqrt(max(total, smallest)))
    return OutputNoise(math.sqrt(white), math.sqrt(drift), float(tau))
