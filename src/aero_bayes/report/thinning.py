"""Long series made light enough to draw without losing their extremes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray


def envelope(time: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Thin a series to the least and the greatest value of every time column.

    A dropped sample can hide a spike; the extremes of each column, joined by lines, look as the whole series does."""
    if len(time) <= 2 * columns:
        return time, values
    starts = _column_starts(time, columns)
    low = np.fmin.reduceat(values, starts)
    high = np.fmax.reduceat(values, starts)
    ends = np.append(starts[1:], len(time)) - 1
    falling = values[ends] < values[starts]
    thinned = np.empty(2 * len(starts))
    thinned[0::2] = np.where(falling, high, low)
    thinned[1::2] = np.where(falling, low, high)
    times = np.empty_like(thinned)
    times[0::2] = time[starts]
    times[1::2] = time[ends]
    return times, thinned


def band_envelope(
    time: FloatArray, low: FloatArray, high: FloatArray, columns: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Thin a band to its least lower and greatest upper edge of every time column."""
    if len(time) <= columns:
        return time, low, high
    starts = _column_starts(time, columns)
    ends = np.append(starts[1:], len(time)) - 1
    middle = 0.5 * (time[starts] + time[ends])
    middle[0], middle[-1] = time[0], time[-1]
    return middle, np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def column_means(time: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Compute the mean of every time column: the slow part of a noisy series."""
    starts = _column_starts(time, columns)
    sizes = np.add.reduceat(np.isfinite(values).astype(np.float64), starts)
    sums = np.add.reduceat(np.where(np.isfinite(values), values, 0.0), starts)
    ends = np.append(starts[1:], len(time)) - 1
    return 0.5 * (time[starts] + time[ends]), np.divide(sums, sizes, out=np.full(len(starts), np.nan), where=sizes > 0)


def _column_starts(time: FloatArray, columns: int) -> NDArray[np.intp]:
    span = time[-1] - time[0]
    column = np.minimum(((time - time[0]) / span * columns).astype(np.intp), columns - 1)
    return np.flatnonzero(np.diff(column, prepend=-1))
