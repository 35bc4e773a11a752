"""Runs of readings: where they begin and end, their neighbours, and how much readings move from one to the next."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]

#: A median absolute deviation times this is the standard deviation of a normal distribution.
MAD_TO_SD = 1.4826
#: Share of samples with a change above which an input moves all the time, and what is then a large step of it, in
#: typical ones.
MAX_CHANGE_SHARE, LARGE_STEP = 0.2, 6.0


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Find the first and one past the last row of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def typical_step(values: FloatArray) -> float:
    """Compute a typical change from one reading to the next: a robust one or, if that is zero, the mean."""
    steps = np.abs(np.diff(values))
    if steps.size == 0:
        return 0.0
    robust = MAD_TO_SD * float(np.median(steps))
    return robust if robust > 0.0 else float(np.mean(steps))


def noise_size(values: FloatArray) -> float:
    """Estimate robustly what changes between readings, straight lines left out: noise, or little for a signal."""
    if values.size < 3:
        return 0.0
    return MAD_TO_SD * float(np.median(np.abs(np.diff(values, 2)))) / math.sqrt(6.0)


def after_changes(inputs: Mapping[str, FloatArray], reach: int = 2) -> Mask:
    """Mark rows from one before to ``reach`` rows after a change of an input."""
    size = len(next(iter(inputs.values()))) if inputs else 0
    near = np.zeros(size, dtype=bool)
    for values in inputs.values():
        steps = np.abs(np.diff(values))
        # Of an input that moves all the time, only its large steps are changes.
        often = np.count_nonzero(steps) > MAX_CHANGE_SHARE * size
        changes = np.flatnonzero(steps > (LARGE_STEP * typical_step(values) if often else 0.0)) + 1
        for offset in range(-1, reach + 1):
            near[np.clip(changes + offset, 0, size - 1)] = True
    return near
