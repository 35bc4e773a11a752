"""Checks of a recording before a model is fitted to it. Each message is one line with file, row and column."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import Layout, Mask, runs
from aero_bayes.declared import ColumnSpec
from aero_bayes.errors import InputError

if TYPE_CHECKING:
    from aero_bayes.data.recording import Recording

#: Smallest number of samples of a recording.
MIN_SAMPLES = 4
RowName = Callable[[int], str]


def check_recording(recording: Recording, layout: Layout | None = None, where: RowName | None = None) -> None:
    """Raise InputError for the first error in a recording."""
    place = where or (lambda row: f"sample {row + 1}")
    name = str(recording.path or recording.name)
    if recording.rows < MIN_SAMPLES:
        raise InputError(f"{name}: {recording.rows} samples, expected at least {MIN_SAMPLES}")

    def refuse(wrong: Mask, column: str, told: str) -> None:
        """Raise InputError for the first row that is wrong, if there is one."""
        if wrong.any():
            raise InputError(f"{name}, {place(int(np.argmax(wrong)))}, column {column}: {told}")

    refuse(~np.isfinite(recording.time), "time", "is missing or not finite, expected seconds")
    _check_order(name, recording.time, place)
    for column, values in recording.inputs.items():
        bad = ~np.isfinite(values)
        first, end = (*runs(bad), (0, 0))[0]
        block = f" ({end - first} in a row)" if end - first > 1 else ""
        refuse(bad, column, f"missing or not finite{block}, expected a value in every row of an input")
    for column, values in recording.outputs.items():
        refuse(np.isinf(values), column, "is infinite, expected a finite reading")
        if (readings := int(np.isfinite(values).sum())) < MIN_SAMPLES:
            raise InputError(f"{name}, column {column}: {readings} readings in {values.size} rows, expected at least "
                             f"{MIN_SAMPLES} (leave the column out if it was not measured)")  # fmt: skip
    if layout is not None:
        _check_rate(name, recording, layout)
        _check_sizes(name, recording, layout, place)


def _check_order(name: str, time: FloatArray, place: RowName) -> None:
    still = np.diff(time) <= 0.0
    if still.any():
        row = int(np.argmax(still)) + 1
        verb = "repeats" if time[row] == time[row - 1] else "runs backwards"
        told = (
            f"{name}, {place(row)}, column time: {verb} ({time[row]:.9g} after {time[row - 1]:.9g}), "
            "expected strictly increasing seconds (of several runs in one table,"
        )
        raise InputError(f"{told} make a recording of each)", f"{told} name their column: [data] batch)")


def _check_rate(name: str, recording: Recording, layout: Layout) -> None:
    low, high = layout.rates
    rate = recording.rate_hz
    if rate < low:
        raise InputError(
            f"{name}, column time: a sample every {1.0 / rate:g} s ({rate:g} Hz), expected {low:g} Hz or more: is it "
            "in ms? Seconds are expected"
        )
    if rate > high:
        raise InputError(
            f"{name}, column time: {rate:g} samples a second, expected {high:g} or fewer: seconds are expected"
        )


def _check_sizes(name: str, recording: Recording, layout: Layout, place: RowName) -> None:
    for quantity in (*layout.inputs, *layout.outputs):
        values = {**recording.inputs, **recording.outputs}.get(quantity.name)
        if values is None:
            continue
        known = [*quantity.words.values()] or np.rint(values)
        wrong = np.flatnonzero(quantity.whole & np.isfinite(values) & ~np.isin(values, known))
        if wrong.size:
            row, named = int(wrong[0]), ", ".join(f"{value:g} ({word})" for word, value in quantity.words.items())
            raise InputError(f"{name}, {place(row)}, column {quantity.name}: {values[row]:g}, expected "
                             f"{f'one of {named}' if named else 'a whole number'}")  # fmt: skip
        if not isfinite(quantity.largest):
            continue
        beyond = np.flatnonzero(np.abs(values) > quantity.largest)
        if beyond.size:
            row = int(beyond[0])
            raise InputError(
                f"{name}, {place(row)}, column {quantity.name}: {values[row]:g} is beyond {quantity.largest:.4g} "
                f"{quantity.unit}, expected {quantity.unit}{_hint(quantity)}"
            )
    if not layout.inputs or layout.inputs[0].name not in recording.inputs:
        return
    drive = layout.inputs[0]
    driven = float(np.abs(recording.inputs[drive.name]).max())
    for quantity in layout.outputs:
        values = recording.outputs.get(quantity.name)
        if values is None:
            continue
        reached = float(np.nanmax(np.abs(values)))
        low, high = quantity.per_input
        if driven >= 1.0 and (0.0 < reached < low * driven or reached > high * driven):
            raise InputError(
                f"{name}, column {quantity.name}: reaches {reached:.3g} where {drive.name} reaches {driven:.3g} "
                f"{drive.unit}, expected {low * driven:.2g} to {high * driven:.2g} {quantity.unit}{_hint(quantity)}"
            )
    if 0.0 < driven < 0.05 and isfinite(drive.largest):
        raise InputError(
            f"{name}, column {drive.name}: reaches only {driven:.3g} {drive.unit}, expected {drive.unit}: is it in "
            f"k{drive.unit} or scaled to 1?"
        )


def _hint(quantity: ColumnSpec) -> str:
    return f": {quantity.hints}" if quantity.hints else ""
