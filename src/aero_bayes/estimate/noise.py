"""The noise model of an output (white noise plus an Ornstein-Uhlenbeck process), and whether a residual is white.

The white part describes the sensor. The Ornstein-Uhlenbeck process, a stationary Gauss-Markov process of first order,
describes slow errors of the sensor or of the model. :mod:`aero_bayes.estimate.noise_estimation` estimates both, and
weighs residuals by them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError

NoiseKind = Literal["white", "ou", "auto"]
#: What a user may declare of an output's noise.
DeclaredNoise = Literal["auto", "white", "ou", "relative", "student", "rounded"]

#: Relative difference of two time steps above which the sampling counts as uneven.
_MAX_STEP_DEVIATION = 1e-3


@dataclass(frozen=True)
class OutputNoise:
    """Noise of one output."""

    sd_white: float
    sd_ou: float = 0.0
    tau: float = 0.0
    white_identified: bool = True
    model_error: bool = False

    @property
    def kind(self) -> Literal["white", "ou"]:
        """``ou`` if there is a correlated part."""
        return "ou" if self.sd_ou > 0.0 and self.tau > 0.0 else "white"

    @property
    def sd(self) -> float:
        """Standard deviation of a single reading."""
        return math.hypot(self.sd_white, self.sd_ou)

    def rho(self, interval: float) -> float:
        """Compute the correlation of two readings that are ``interval`` seconds apart."""
        if self.kind == "white":
            return 0.0
        return (self.sd_ou / self.sd) ** 2 * math.exp(-interval / self.tau)

    @property
    def estimated(self) -> tuple[bool, bool, bool]:
        """Which of ``sd_white``, ``sd_ou`` and ``tau`` the data determine."""
        correlated = self.kind == "ou" and not self.model_error
        return (self.white_identified and not self.model_error, correlated, correlated)

    def as_row(self) -> tuple[float, float, float]:
        """Return ``(sd_white, sd_ou, tau)``, as a simulator takes them."""
        return (self.sd_white, self.sd_ou, self.tau)


@dataclass(frozen=True)
class NoiseModel:
    """Which noise each output may have, and which the states have.

    Parameters
    ----------
    default : {"auto", "white", "ou", "relative", "student", "rounded"}
        Of outputs that ``outputs`` does not name; ``auto`` lets the data choose. ``relative`` has the standard
        deviation ``a + b |y|``, ``student`` has heavy tails, ``rounded`` is white, at least as large as the rounding.
    outputs : tuple of (str, kind)
    sd : mapping of str to float, or to a mapping of str to float
        Standard deviation of white noise by output, in its unit, where it is known; one value, or one a recording by
        its name.
    process : mapping of str to float or "estimated"
        Process noise by state: its diffusion in the state's unit over the square root of a second. Each of these states
        gains ``diffusion dW``, with W a Wiener process of its own; the noise of all readings is then white.
    initial_sd : mapping of str to float
        With process noise, how far a state's initial value may be off the model's own: its standard deviation. Other
        states start as without process noise.

    Examples
    --------
    >>> NoiseModel(process={"v": "estimated"}).kind("position")
    'white'
    """

    default: DeclaredNoise = "auto"
    outputs: tuple[tuple[str, DeclaredNoise], ...] = ()
    sd: Mapping[str, float | Mapping[str, float]] = field(default_factory=dict)
    process: Mapping[str, float | Literal["estimated"]] = field(default_factory=dict)
    initial_sd: Mapping[str, float] = field(default_factory=dict)

    def kind(self, output: str) -> NoiseKind:
        """Return the correlation over time that an output's noise may have."""
        declared = self.declared(output)
        if self.process or output in self.sd or declared == "rounded":
            return "white"
        return declared if declared in ("white", "ou") else "auto"

    def spread_kind(self, output: str) -> Literal["auto", "constant", "relative", "student"]:
        """Return how the noise of an output may differ from reading to reading."""
        declared = self.declared(output)
        if self.process or output in self.sd or declared in ("white", "ou", "rounded"):
            return "constant"
        return declared if declared in ("relative", "student") else "auto"

    def sd_by_recording(self, output: str, recordings: Sequence[str]) -> list[float] | None:
        """Return the known standard deviation of an output in each recording; None where it is not declared."""
        known = self.sd.get(output)
        if not isinstance(known, Mapping):
            return None if known is None else [known] * len(recordings)
        for name in recordings:
            if name not in known:
                told = f"no value for recording {name}; there are {', '.join(known)}"
                raise InputError(f"noise: sd of {output}: {told}", f"[noise.{output}] sd: {told}")
        return [known[name] for name in recordings]

    def declared(self, output: str) -> DeclaredNoise:
        """Return what was declared of an output's noise."""
        return dict(self.outputs).get(output, self.default)


@dataclass(frozen=True, eq=False)
class SampleTimes:
    """When one output of one recording was read."""

    index: NDArray[np.int_]
    time: FloatArray
    interval: float
    even: bool
    spread: FloatArray | None = None

    @classmethod
    def of(cls, time: FloatArray, values: FloatArray, spread: FloatArray | None = None) -> SampleTimes:
        """Take times (n,) at which ``values`` (n,) are not NaN, with the relative spread (n,) of their noise."""
        index = np.flatnonzero(np.isfinite(values))
        seen, own = time[index], None if spread is None else spread[index]
        if seen.size < 2:
            return cls(index, seen, 1.0, True, own)
        steps = np.diff(seen)
        interval = float(np.median(steps))
        slack = max(_MAX_STEP_DEVIATION * interval, 1e-9 * abs(float(seen[-1])))
        return cls(index, seen, interval, bool(np.all(np.abs(steps - interval) <= slack)), own)

    @property
    def size(self) -> int:
        """Number of readings."""
        return int(self.index.size)

    def equalised(self, rows: FloatArray) -> FloatArray:
        """Divide rows (k, n), or one (n,), by the relative spread of each reading: their noise is then even."""
        return rows if self.spread is None else rows / self.spread

    @property
    def duration(self) -> float:
        """Time in s from the first to the last reading."""
        return float(self.time[-1] - self.time[0]) if self.size else 0.0


#: Probability that all tests of a fit together call noise correlated or structured.
FALSE_ALARM_RATE = 1e-3

#: Readings that each lag of a test needs: with fewer, independent noise fails the test too often.
READINGS_A_LAG = 25
#: Autocorrelation at which the sum for the autocorrelation time ends, and the lag, in autocorrelation times.
MIN_AUTOCORRELATION, AUTOCORRELATION_WINDOW = 0.05, 5.0
#: Least speed of a rotor whose ripple is faster than other motion, in rad/s.
MIN_ROTOR_SPEED = 20.0


def autocovariance(series: FloatArray, mean: float | None = None) -> FloatArray:
    """Compute the autocovariance along the last axis by FFT, divided by n, about a known mean or that of each."""
    n = series.shape[-1]
    centred = series - (series.mean(axis=-1, keepdims=True) if mean is None else mean)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(centred, size, axis=-1)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, size, axis=-1)[..., :n] / n)


def autocorrelation(values: FloatArray, lags: int | None = None) -> FloatArray:
    """Compute the autocorrelation at lags 0, 1, ..., ``lags`` samples, by FFT."""
    centred = np.where(np.isfinite(values), values - np.nanmean(values), 0.0)
    products = autocovariance(centred, 0.0)[: None if lags is None else lags + 1]
    return products / products[0] if products[0] > 0.0 else np.zeros_like(products)


def correlation_p_value(a: FloatArray, b: FloatArray, lags: int = 20) -> float:
    """Compute the probability that independent noise is as correlated as two series are.

    A series is compared with itself at positive lags, with another one at lags of both signs and at zero."""
    x, y = a - a.mean(), b - b.mean()
    used = min(lags, max(x.size // READINGS_A_LAG, 1))
    pairs = [(x[k:], y[: y.size - k]) for k in range(1 if a is b else 0, used + 1)]
    if a is not b:
        pairs += [(x[: x.size - k], y[k:]) for k in range(1, used + 1)]
    total = 0.0
    for one, other in pairs:
        product = one * other
        spread = float(product @ product)
        if spread > 0.0:
            total += float(product.sum()) ** 2 / spread
    return float(chdtrc(len(pairs), total))


def is_rotor_speed(readings: FloatArray, unit: str) -> bool:
    """Return whether readings (n,) are the speed of a rotor, fast enough to tell its ripple from other motion."""
    seen = readings[np.isfinite(readings)]
    return unit == "rad/s" and seen.size > 100 and float(np.max(np.abs(seen))) >= MIN_ROTOR_SPEED


def ripple_means(innovations: FloatArray, interval: float, length: float = 0.2) -> FloatArray:
    """Average innovations over stretches of time: a rotor's ripple is faster, missing physics slower."""
    width = max(round(length / interval), 1)
    count = innovations.size // width
    if count < 20:
        return innovations
    means: FloatArray = innovations[: count * width].reshape(count, width).mean(axis=1)
    return means


def integrated_time(correlation: FloatArray, smallest: float = -math.inf) -> float:
    """Integrate an autocorrelation (n,): the readings that count as one independent reading, in samples.

    The sum ends at a lag of :data:`AUTOCORRELATION_WINDOW` times itself (Sokal, 1997, Monte Carlo methods in
    statistical mechanics), or before the correlation falls below ``smallest``."""
    times = 2.0 * np.cumsum(correlation) - 1.0
    window = np.flatnonzero(np.arange(times.size) >= AUTOCORRELATION_WINDOW * times)
    small = np.flatnonzero(correlation < smallest)
    ends = (window[0] if window.size else times.size - 1, small[0] - 1 if small.size else times.size - 1)
    return float(times[max(min(ends), 0)])


def residual_correlation_time(residuals: Sequence[FloatArray]) -> float:
    """Compute the integrated autocorrelation time in samples, at least 1, over several recordings of one output.

    The sum ends where the autocorrelation falls below :data:`MIN_AUTOCORRELATION`: beyond, a single recording gives
    mostly its own scatter."""
    total = sum(r.size for r in residuals)
    return sum(r.size * _correlation_time_of_series(r) for r in residuals) / max(total, 1)


def _correlation_time_of_series(residual: FloatArray) -> float:
    correlation = autocorrelation(residual)[: max(residual.size // 3, 1)]
    return max(integrated_time(correlation, MIN_AUTOCORRELATION), 1.0) if correlation[0] > 0.0 else 1.0


def block_variance_ratio(values: FloatArray, sizes: tuple[int, ...] = (10, 30, 100, 300)) -> float:
    """Compute the variance of block means over what white noise of the same variance would have.

    The largest over sizes."""
    seen = values[np.isfinite(values)]
    variance = float(np.var(seen)) if seen.size else 0.0
    worst = 0.0
    for size in sizes:
        count = seen.size // size
        if count >= 40 and variance > 0.0:
            means = seen[: count * size].reshape(count, size).mean(axis=1)
            worst = max(worst, float(np.mean(means**2)) * size / variance)
    return worst
