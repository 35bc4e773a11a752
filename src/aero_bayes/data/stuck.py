"""Sensors that repeat a reading: stuck at any value, or clipped at an end of their range.

Both are seen only in a channel whose readings do not repeat elsewhere, and move just before or after. Where each
reading has noise, a run of equal ones is a fault. Where none has, what is measured may rest, as an arm that friction
holds: a sensor that was stuck then jumps to what it missed, and a clipped one comes to its limit at full speed. What
rests before any input changes, a counter at rest and a simulation that has settled repeat by right.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.noise import quantisation_step
from aero_bayes.data.runs import MAD_TO_SD, Mask, after_changes, noise_size, runs

#: Fewest equal readings in a row that are stuck, and that are clipped at an extreme.
MIN_STUCK, MIN_CLIPPED = 10, 4
#: Share of neighbouring readings elsewhere that may be equal, in a channel that can be judged.
MAX_EQUAL_SHARE = 0.05
#: Readings before and after a run that must show noise, and how much of the channel's usual one.
BESIDE, MIN_NOISE_SHARE = 20, 0.3
#: Size of third differences over second ones, each over that of white noise, from which readings are noisy.
MIN_NOISE_RATIO = 0.8
#: Jump after a stuck run over an ordinary step, and speed before a clipped one over its change from reading to reading.
MIN_MISSED, MIN_SPEED = 2.0, 5.0
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
    noisy, begun = _is_noisy(seen[~inside]), np.searchsorted(at, _first_change(inputs))
    ordinary = float(np.quantile(np.abs(np.diff(seen))[elsewhere], 0.95))
    for start, stop in chosen:
        around = np.concatenate([seen[max(start - BESIDE, 0) : start], seen[stop : stop + BESIDE]])
        # What rests before a run begins reads the same by right, and so does what cannot fall below zero.
        if start == 0 or start < begun or usual <= 0.0 or noise_size(around) < MIN_NOISE_SHARE * usual:
            continue
        if not (noisy or _missed(seen, stop, ordinary) or (seen[start] in ends and _abrupt(seen, start))):
            continue
        if seen[start] in ends and seen[start] != 0.0:
            clipped[at[seen == seen[start]]] = True
        elif seen[start] != 0.0 or (not near[start] and _jumps(seen, start, stop, usual)):
            stuck[at[start + 1 : stop]] = True
    return stuck, clipped


def _is_noisy(values: FloatArray) -> bool:
    """Return whether each reading has noise: then third differences are as large as second ones, and not rounded."""
    if values.size < 3 * MIN_STUCK or quantisation_step(values) is not None:
        return False
    third = MAD_TO_SD * float(np.median(np.abs(np.diff(values, 3)))) / math.sqrt(20.0)
    return third > MIN_NOISE_RATIO * noise_size(values)


def _first_change(inputs: Mapping[str, FloatArray]) -> int:
    """Return the row at which an input first changes; 0 where none does."""
    rows = [int(np.argmax(values != values[0])) for values in inputs.values()]
    return min((row for row in rows if row), default=0)


def _missed(seen: FloatArray, stop: int, ordinary: float) -> bool:
    """Return whether the reading after a run jumps to what the sensor missed."""
    return stop < seen.size and abs(float(seen[stop] - seen[stop - 1])) > MIN_MISSED * ordinary


def _abrupt(seen: FloatArray, start: int) -> bool:
    """Return whether a run begins at full speed: what comes to rest slows down before."""
    if start < 3:
        return False
    before, last = float(seen[start - 2] - seen[start - 3]), float(seen[start - 1] - seen[start - 2])
    return abs(last) > MIN_SPEED * abs(last - before)


def _jumps(seen: FloatArray, start: int, stop: int, usual: float) -> bool:
    """Return whether a run begins and ends with a jump: a flow that was shut off rests at zero by right."""
    before = abs(seen[start] - seen[start - 1]) if start else np.inf
    after = abs(seen[stop] - seen[stop - 1]) if stop < seen.size else np.inf
    return bool(min(before, after) > 10.0 * usual)
