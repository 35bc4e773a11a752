"""From a recording to an experiment that a simulator can run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.simulation.interface import Experiment, InputSignal, Interpolation

#: How long before the first sample the earlier input value is placed, in s: longer than any input delay.
INPUT_LEAD_TIME = 1.0


def to_experiment(
    recording: Recording,
    outputs: Sequence[str] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    before: Mapping[str, float] | None = None,
    zero_at_rest: Sequence[str] | None = None,
    interpolation: Mapping[str, Interpolation] | Interpolation = "hold",
) -> Experiment:
    """Return the experiment that a simulator runs. Held inputs are reduced to the samples at which they change."""
    names = tuple(outputs) if outputs is not None else tuple(recording.outputs)
    known = _input_before_start(recording, zero_at_rest) | dict(before or {})
    linear = set(recording.inputs) if interpolation == "linear" else set()
    if not isinstance(interpolation, str):
        linear = {name for name, how in interpolation.items() if how == "linear"}
    signals = tuple(
        InputSignal(name, np.ascontiguousarray(recording.time), np.ascontiguousarray(values), "linear")
        if name in linear
        else _hold_signal(name, recording.time, values, known.get(name))
        for name, values in recording.inputs.items()
    )
    return Experiment(
        time=np.ascontiguousarray(recording.time),
        outputs=names,
        inputs=signals,
        start=dict(start or {}),
        measured=recording.measured(names),
        known=recording.known,
    )


def _hold_signal(name: str, time: FloatArray, values: FloatArray, before: float | None = None) -> InputSignal:
    """Return a piecewise constant input with a point at every change.

    ``before`` is its value until the first sample."""
    keep = np.concatenate(([True], values[1:] != values[:-1]))
    grid, levels = time[keep], values[keep]
    if before is not None and before != levels[0]:
        grid, levels = np.concatenate(([time[0] - INPUT_LEAD_TIME], grid)), np.concatenate(([before], levels))
    return InputSignal(name, np.ascontiguousarray(grid), np.ascontiguousarray(levels), "hold")


def _input_before_start(
    recording: Recording, zero_at_rest: Sequence[str] | None = None, share: float = 0.02
) -> dict[str, float]:
    """Return the value of each input before the first sample: zero if the rig was at rest, else its first value.

    The first recorded output among ``zero_at_rest`` decides. If it begins at nearly zero (``share`` of its largest
    value), the rig was at rest. If none of them was recorded, the rig counts as at rest."""
    moving = not zero_at_rest
    for name in zero_at_rest or ():
        if name in recording.outputs:
            values = recording.outputs[name]
            seen = np.abs(values[np.isfinite(values)])
            first = np.abs(values[: min(3, values.size)])
            first = first[np.isfinite(first)]
            moving = bool(seen.size and first.size and first.min() > share * seen.max())
            break
    if moving:
        return {name: float(values[0]) for name, values in recording.inputs.items()}
    return {name: 0.0 for name in recording.inputs}
