"""Sensors that send rarely: their last reading stands in the rows of a faster table until the next one comes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import Mask, Rows

#: Fewest changes of the readings that show a period.
MIN_CHANGES = 12
#: Distances between changes that are about one period: up to this many times the short ones. Quantile of what is small.
ONE_PERIOD, SMALL_QUANTILE = 1.6, 0.1
#: Share of the distances within a row of whole periods, and of those up to half a period.
MIN_WHOLE, MAX_HALF = 0.9, 0.03
#: The median change over a small one, from which changes are no single steps of a coarse reading.
SINGLE_STEP = 1.5
#: Changes of an input over those of an output that follows it at once.
MORE_OFTEN = 1.5


def held_period(values: FloatArray, inputs: Mapping[str, FloatArray]) -> tuple[float, Mask] | None:
    """Return the rows from one message of a sensor to the next, and mark the rows at which one came.

    None where the readings do not repeat like this: of a coarse or slow one the changes are single steps, and of what
    follows an input at once they come with those of the input."""
    there = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[there])
    changes = there[1:][steps != 0.0]
    if changes.size < MIN_CHANGES:
        return None
    distances, sizes = np.diff(changes), np.abs(steps[steps != 0.0])
    one = distances[distances <= ONE_PERIOD * np.quantile(distances, SMALL_QUANTILE, method="lower")]
    period = float(one.mean())
    whole = np.abs(distances - period * np.rint(distances / period)) <= 1.0
    if period < 2.0 or whole.mean() < MIN_WHOLE or np.mean(distances <= 0.5 * period) > MAX_HALF:
        return None
    if np.median(sizes) <= SINGLE_STEP * np.quantile(sizes, SMALL_QUANTILE) or _with_inputs(values, changes, inputs):
        return None
    came = np.zeros(values.size, dtype=bool)
    for start, stop in zip(changes, [*changes[1:].tolist(), there[-1] + 1], strict=True):
        came[start + np.rint(period * np.arange(max(round((stop - start) / period), 1))).astype(int)] = True
    # What stands in the first row may be old: its time is counted back from the first change.
    before = np.rint(period * np.arange(1, changes[0] / period + 1)).astype(int)
    came[changes[0] - before[before <= changes[0]]] = True
    came &= np.isfinite(values)
    return (period, came) if came.sum() < there.size else None


def _with_inputs(values: FloatArray, changes: Rows, inputs: Mapping[str, FloatArray]) -> bool:
    """Return whether an output is a function of inputs: most of its changes come with theirs, or a row later.

    Of an input, most must do so; one that changes much more often does so by chance. Where the same values of these
    inputs come with other values of the output, it is no function of them."""
    followed = np.isin(np.arange(changes[-1] + 2), [changes, changes - 1])
    moved, given_then = np.zeros(followed.size, dtype=bool), []
    for given in inputs.values():
        own = 1 + np.flatnonzero(np.diff(given[: followed.size - 1]))
        if 0 < own.size <= MORE_OFTEN * changes.size and followed[own].mean() > 0.5:
            moved[own] = moved[own + 1] = True
            given_then.append(given[changes])
    if moved[changes].mean() <= 0.5:
        return False
    _, at, times = np.unique(np.column_stack(given_then), axis=0, return_inverse=True, return_counts=True)
    pairs = np.unique(np.column_stack([at.ravel(), values[changes]]), axis=0).shape[0] - times.size
    return bool(pairs <= 0.5 * (changes.size - times.size))
