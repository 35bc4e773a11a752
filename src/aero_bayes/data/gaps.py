"""Times without samples: what the inputs did there is not known, so that the part after it begins anew."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.runs import Rows

#: Length of a gap in usual intervals. An input that holds over fewer is hardly wrong for long.
MIN_GAP_INTERVALS = 10.0
#: A sampling is even where this share of its intervals is within a factor of two of the usual one.
EVEN_SHARE = 0.95
#: Fewest samples of a part, and most parts: each has its own initial state.
MIN_PART_ROWS, MAX_PARTS = 20, 10


def gap_rows(time: FloatArray, inputs: Mapping[str, FloatArray]) -> Rows:
    """Find the first rows after a gap, of the longest gaps if there are many.

    A logger that writes changes only has long intervals by right, and inputs that were constant for as long before and
    after a gap were most likely constant in it: neither counts."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    if usual <= 0.0 or np.mean((steps > 0.5 * usual) & (steps < 2.0 * usual)) < EVEN_SHARE:
        return np.empty(0, dtype=np.intp)
    rows = np.flatnonzero(steps >= MIN_GAP_INTERVALS * usual) + 1
    rows = np.array([r for r in rows if not _held(time, inputs, int(r))], dtype=np.intp)
    longest = rows[np.argsort(-steps[rows - 1], kind="stable")][: MAX_PARTS - 1]
    return np.sort(longest)


def _held(time: FloatArray, inputs: Mapping[str, FloatArray], row: int) -> bool:
    """Return whether every input was the same for the length of a gap before it and after it."""
    length = time[row] - time[row - 1]
    beside = (time >= time[row - 1] - length) & (time <= time[row] + length)
    return all(np.ptp(values[beside]) == 0.0 for values in inputs.values())
