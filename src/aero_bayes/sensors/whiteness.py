"""Whether a residual is white: autocovariance, autocorrelation, and the variance of block means."""

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


def autocorrelation(values: FloatArray, lags: int | None = None) -> FloatArray:
    """Autocorrelation at lags 0, 1, ..., ``lags`` samples, by FFT.

    Parameters
    ----------
    values : ndarray, shape (n,)
        NaN in gaps, which do not count.
    lags : int, optional
        The largest lag; n - 1 by default, and at most.

    Returns
    -------
    ndarray, shape (lags + 1,)
        1 at lag 0. The estimate is biased (every lag is divided by the number of pairs at lag 0), so that it is never
        above 1. Zero for a constant series.
    """
    centred = np.where(np.isfinite(values), values - np.nanmean(values), 0.0)
    products = autocovariance(centred, 0.0)[: None if lags is None else lags + 1]
    return products / products[0] if products[0] > 0.0 else np.zeros_like(products)


def block_variance_ratio(values: FloatArray, sizes: tuple[int, ...] = (10, 30, 100, 300)) -> float:
    """Variance of block means over what white noise of the same variance would have; the largest over block sizes.

    It is the batch means estimate of the integrated autocorrelation time. Above one, errors are slower than the noise
    model says, and averages (hence parameters) are less certain. Fast ripple makes it less than one. Only sizes that
    give at least 40 blocks count.
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
