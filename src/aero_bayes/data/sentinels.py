"""Constants that stand for "no reading": -999 of a historian, 85 degC of a sensor without power, 0 of a dead one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.runs import MAD_TO_SD, Mask, after_changes, runs, typical_step

#: What loggers and sensors are known to write for a reading that they do not have.
KNOWN_CONSTANTS = frozenset({
    -99999.0, -9999.0, -9999.9, -999.9, -999.0, -99.9, -99.0, 99.9, 99.0, 999.0, 999.9, 9999.0, 9999.9, 99999.0,
    85.0, -127.0, -50.0, 0.0, 32767.0, -32768.0, 65535.0, 3276.7, -3276.8, 6553.5, 2147483647.0, -2147483648.0,
})  # fmt: skip
#: Longest run of a constant that is no reading, in rows; a known one that is impossible may last longer.
MOST_ROWS = 5
#: Largest share of the readings that such constants may be; a signal that is there more often is a signal.
MAX_SHARE = 0.2
#: Distance from both neighbours, in typical steps, from which a constant within the range is far off them.
MIN_STEPS_OFF = 8.0
#: Readings of a constant within the range of the others, and distinct other readings, that it takes.
MIN_REPEATS, MIN_DISTINCT = 3, 5
#: The median step without any one constant, a fifth of the readings at most, is no less than this quantile with it.
LOW_QUANTILE = 0.15
#: Share of a constant's runs that must be far off for a closer look; its runs are split by gaps there.
LEAST_ISOLATED = 0.4
#: Fewest readings that show what is usual.
MIN_SENTINEL_READINGS = 12


def sentinels(values: FloatArray, inputs: Mapping[str, FloatArray]) -> dict[float, Mask]:
    """Mark rows of an output at constants that are no readings, by constant."""
    found: dict[float, Mask] = {}
    left = np.isfinite(values)
    near = after_changes(inputs) if inputs else np.zeros(values.size, dtype=bool)
    for _ in range(MIN_DISTINCT):
        constant = _farthest_outside(values, left, near)
        if constant is None:
            break
        found[constant] = left & (values == constant)
        left &= ~found[constant]
    likely = _likely(values[left])
    for constant in _repeated(values, left):
        if constant not in likely:
            continue
        rows = left & (values == constant)
        if _far_off(values, left, rows, near):
            found[constant] = rows
            left = left & ~rows
            likely = _likely(values[left])
    return found


def impossible_inputs(values: FloatArray) -> dict[float, Mask]:
    """Mark rows of an input at known constants that are farther outside of its other values than these range."""
    none = np.zeros(values.size, dtype=bool)
    constant = _farthest_outside(values, np.isfinite(values), none)
    if constant is None or constant not in KNOWN_CONSTANTS or constant == 0.0:
        return {}
    return {constant: values == constant}


def _farthest_outside(values: FloatArray, left: Mask, near: Mask) -> float | None:
    """Return the constant that is farthest outside of the range of all others; None if none is impossible."""
    seen = values[left]
    if seen.size < MIN_SENTINEL_READINGS:
        return None
    for constant in (float(seen.min()), float(seen.max())):
        rows = left & (values == constant)
        others = seen[seen != constant]
        count = int(rows.sum())
        if count > MAX_SHARE * seen.size or np.unique(others).size < MIN_DISTINCT:
            continue
        low, high = float(others.min()), float(others.max())
        outside = max(low - constant, constant - high)
        known = constant in KNOWN_CONSTANTS
        if outside <= high - low or not (known or count >= 2):
            continue
        own = runs(rows)
        if not (known and constant != 0.0) and max(stop - start for start, stop in own) > MOST_ROWS:
            continue
        if not known and sum(bool(near[start]) for start, _ in own) > 0.5 * len(own):
            continue
        return constant
    return None


def _repeated(values: FloatArray, left: Mask) -> list[float]:
    """Find constants that occur often enough, and not too often; none for a sensor with coarse steps."""
    seen = values[left]
    if seen.size < MIN_SENTINEL_READINGS:
        return []
    distinct, counts = np.unique(seen, return_counts=True)
    keep = (counts >= MIN_REPEATS) & (counts <= MAX_SHARE * seen.size)
    # Of readings in coarse steps every one is repeated: looking at each would only cost time.
    return [] if keep.sum() > 0.2 * distinct.size + 3 else [float(v) for v in distinct[keep]]


def _likely(seen: FloatArray) -> set[float]:
    """Return the constants that may be far off their neighbours, from one pass over all readings.

    Each is looked at by itself
    at the cost of all readings, and a long recording has a hundred thousand that occur three times."""
    each = seen[np.concatenate(([True], np.diff(seen) != 0.0))]
    if each.size < 3:
        return set()
    step = MAD_TO_SD * float(np.quantile(np.abs(np.diff(seen)), LOW_QUANTILE, method="lower"))
    off = np.minimum(*(np.abs(each[1:-1] - other) for other in (each[:-2], each[2:])))
    apart = (off > MIN_STEPS_OFF * step) & (off > 3.0 * np.abs(each[2:] - each[:-2]))
    distinct, at = np.unique(each[1:-1], return_inverse=True)
    isolated, total = np.bincount(at, apart, distinct.size), np.bincount(at, minlength=distinct.size)
    return set(distinct[(isolated > 0) & (isolated >= LEAST_ISOLATED * total)].tolist())


def _far_off(values: FloatArray, left: Mask, rows: Mask, near: Mask) -> bool:
    """Return whether nearly each run of a constant is short and far off the readings before and after, which agree."""
    at = np.flatnonzero(left & ~rows)
    step = typical_step(values[at])
    isolated = total = 0
    for start, stop in runs(rows):
        total += 1
        place = int(np.searchsorted(at, start))
        if stop - start > MOST_ROWS or near[start] or not 0 < place < at.size:
            continue
        before, after = values[at[place - 1]], values[at[place]]
        off = min(abs(values[start] - before), abs(values[start] - after))
        isolated += bool(off > MIN_STEPS_OFF * step and off > 3.0 * abs(after - before))
    return isolated >= 2 and isolated >= 0.8 * total
