"""Check before a fit that a recording can be one of the model: its inputs and the units of its temperatures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.data import Recording, screen_all
from aero_bayes.data.file_forms import column_names
from aero_bayes.errors import InputError
from aero_bayes.estimate.initial_states import state_of
from aero_bayes.simulation import Model, Variable
from aero_bayes.unknown_names import closest_name

#: If the model starts above the first temperature in K, readings that begin below the second must be degrees Celsius.
MIN_KELVIN_START, MAX_CELSIUS_READING = 200.0, 150.0


def check_plausible(recordings: Iterable[Recording], model: Model) -> None:
    """Refuse recordings that lack an input of the model, or whose temperatures are in another unit."""
    for recording in recordings:
        _check_inputs(recording, model)
        _check_temperatures(recording, model)


def screened(recordings: Sequence[Recording], model: Model) -> tuple[Recording, ...]:
    """Mend and tell faults of recordings, and cut them at gaps; units that they lack are the model's."""
    units = {v.name: v.unit for v in (*model.inputs, *model.outputs)}
    return screen_all([replace(r, units={**units, **r.units}) if set(units) - set(r.units) else r for r in recordings])


def _check_inputs(recording: Recording, model: Model) -> None:
    missing = [v.name for v in model.inputs if v.name not in recording.inputs]
    if missing:
        path = recording.path
        there = column_names(path) if path is not None and path.is_file() else [*recording.inputs, *recording.outputs]
        close = closest_name(missing[0], there)
        meant = f"; did you mean {close}?" if close else ""
        raise InputError(
            f"{path or recording.name}: the input {missing[0]} of model {model.name} has no column (there are "
            f"{', '.join(there)}{meant}); name it in [data] inputs and [data.columns.{missing[0]}], or give it a "
            f"value: [data] constants = {{{missing[0]} = ...}}"
        )


def _check_temperatures(recording: Recording, model: Model) -> None:
    warm = max((s.start or 0.0 for s in model.states if s.unit == "K"), default=0.0)
    for v in (*model.inputs, *model.outputs):
        values = {**recording.inputs, **recording.outputs}.get(v.name)
        if v.unit != "K" or values is None or not np.isfinite(values).any():
            continue
        start, first = _start(v, model) or warm, float(values[np.isfinite(values)][0])
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        if start > MIN_KELVIN_START and first < MAX_CELSIUS_READING:
            raise InputError(
                f"{recording.path or recording.name}, column {v.name}: reads {low:.4g} to {high:.4g}, where the model "
                f'starts at {start:.4g} K: looks like degC or degF; say so, as by [data.columns.{v.name}] unit = "degC"'
            )


def _start(v: Variable, model: Model) -> float | None:
    state = state_of(model, v.name)
    return v.start if state is None else state.start
