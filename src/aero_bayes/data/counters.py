"""Counters that roll over or are reset, told by how they fall."""

from __future__ import annotations

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import Mask

#: Values at which counters roll over.
MODULI = (*(2.0**n for n in (8, 10, 12, 14, 15, 16, 20, 24, 31, 32)), *(10.0**n for n in range(2, 10)))
#: Fewest rises, and falls over rises at most, that show a counter; what it falls by, in largest rises.
MIN_RISES, MAX_FALLS, MIN_FALL = 20, 0.1, 4.0
#: A counter comes as close to its end, and begins as low again, as this many of its largest rises.
CLOSE = 1.5


def counter_falls(values: FloatArray) -> tuple[Mask, float | None] | None:
    """Return where a counter falls, and the value at which it rolls over, None for one that is reset.

    None where the values do not only rise but for falls to about zero."""
    there = np.flatnonzero(np.isfinite(values))
    seen = values[there]
    steps = np.diff(seen)
    rises, down = steps[steps > 0.0], np.flatnonzero(steps < 0.0)
    if rises.size < MIN_RISES or not 0 < down.size <= MAX_FALLS * rises.size or seen.min() < 0.0:
        return None
    close = CLOSE * float(rises.max())
    before, after = seen[down], seen[down + 1]
    if after.max() > close or np.min(before - after) < MIN_FALL * close / CLOSE:
        return None
    rows = np.isin(np.arange(values.size), there[down + 1])
    known = [m for m in MODULI if before.max() < m <= before.min() + close]
    # At an end of its own a counter falls by the same amount each time, but for one rise.
    own = float(np.round(np.median(before - after + rises.mean()), 6)) if down.size > 1 else None
    return rows, known[0] if known else own if np.ptp(before) <= close else None
