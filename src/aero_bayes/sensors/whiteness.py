"""Is a residual white: autocovariance, and averages that wander more than those of white noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def autocovariance(series: FloatArray, mean: float | None = None) -> FloatArray:
    """Autocovariance along the last axis by FFT, biased (divided by n), about a known mean or that of each series."""
    n = series.shape[-1]
    centred = series - (series.mean(axis=-1, keepdims=True) if mean is None else mean)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(centred, size, axis=-1)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, size, axis=-1)[..., :n] / n)


def block_variance_ratio(values: FloatArray, sizes: tuple[int, ...] = (10, 30, 100, 300)) -> float:
    """Variance of block averages over what white noise of the same variance would have; the largest over block sizes.

    Above one, slow errors are larger than the noise model says, and averages (hence parameters) are less certain than
    it says. Fast ripple leaves it below one. Only sizes with 40 blocks or more count.
    """
    seen = values[np.isfinite(values)]
    variance = float(np.var(seen)) if seen.size else 0.0
    worst = 0.0
    for size in sizes:
        count = seen.size // size
        if count >= 40 and variance > 0.0:
            means = seen[: count * size].reshape(count, size).mean(axis=1)
            worst = max(worst, float(np.mean(means**2)) * size / variance)
    return worst
