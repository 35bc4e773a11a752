"""Whether a residual is white: autocovariance, tests of correlation, correlation time, variance of block means."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc

from aero_bayes.arrays import FloatArray

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
