"""Sensors that repeat a reading: stuck at any value, or clipped at an end of their range.

Both are seen only in a channel that has noise: its readings do not repeat elsewhere, and the noise is there just before
or after. Readings of a simulation without noise that have settled, a counter at rest and an angle at its stop repeat by
right.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.runs import Mask, after_changes, noise_size, runs

#: Fewest equal readings in a row that are stuck, and that are clipped at an extreme.
MIN_STUCK, MIN_CLIPPED = 10, 4
#: Share of neighbouring readings elsewhere that may be equal, in a channel that can be judged.
MAX_EQUAL_SHARE = 0.05
#: Readings before and after a run that must show noise, and how much of the channel's usual one.
BESIDE, MIN_NOISE_SHARE = 20, 0.3
#: Share of the range within which two readings count as one: a print format may differ in the last digit.
SAME = 1e-9


def stuck_rows(values: FloatArray, inputs: Mapping[str, FloatArray]) -> tuple[Mask, Mask]:
    """Mark rows where an output is stuck, and rows where it is clipped."""
    stuck, clipped = np.zeros(values.size, dtype=bool), np.zeros(values.size, dtype=bool)
    at = np.flatnonzero(np.isfinite(values))
    seen = values[at]
    if seen.size < 3 * MIN_STUCK or np.ptp(seen) == 0.0:
        return stuck, clipped
    equal = np.abs(np.diff(seen)) <= SAME * np.ptp(seen)
    spans = [(start, stop + 1) for start, stop in runs(equal)]
    ends = seen.min(), seen.max()
    chosen = [
        (start, stop) for start, stop in spans if stop - start >= (MIN_CLIPPED if seen[start] in ends else MIN_STUCK)
    ]
    inside = np.zeros(seen.size, dtype=bool)
    for start, stop in chosen:
        inside[start:stop] = True
    elsewhere = ~(inside[:-1] | inside[1:])
    if not chosen or elsewhere.sum() < MIN_STUCK or equal[elsewhere].mean() > MAX_EQUAL_SHARE:
        return stuck, clipped
    usual, near = noise_size(seen[~inside]), after_changes(inputs)[at] if inputs else np.zeros(at.size, dtype=bool)
    for start, stop in chosen:
        around = np.concatenate([seen[max(start - BESIDE, 0) : start], seen[stop : stop + BESIDE]])
        # What rests before a run begins reads the same by right, and so does what cannot fall below zero.
        if start == 0 or usual <= 0.0 or noise_size(around) < MIN_NOISE_SHARE * usual:
            continue
        if seen[start] in ends and seen[start] != 0.0:
            clipped[at[seen == seen[start]]] = True
        elif seen[start] != 0.0 or (not near[start] and _jumps(seen, start, stop, usual)):
            stuck[at[start + 1 : stop]] = True
    return stuck, clipped


def _jumps(seen: FloatArray, start: int, stop: int, usual: float) -> bool:
    """Return whether a run begins and ends with a jump: a flow that was shut off rests at zero by right."""
    before = abs(seen[start] - seen[start - 1]) if start else np.inf
    after = abs(seen[stop] - seen[stop - 1]) if stop < seen.size else np.inf
    return bool(min(before, after) > 10.0 * usual)
