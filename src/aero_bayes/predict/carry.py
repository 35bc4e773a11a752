"""What fitted recordings tell of one that was not: its delay and its start follow theirs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.starts import state_of
from aero_bayes.simulation.interface import StartTarget, Target

FloatArray = NDArray[np.float64]


def typical(calibration: Calibration, values: FloatArray, recordings: Sequence[Recording]) -> dict[Target, FloatArray]:
    """Mean over the fitted recordings of what belongs to each alone.

    Parameters
    ----------
    calibration : Calibration
    values : ndarray, shape (..., p)
        SI values of its parameters.
    recordings : sequence of Recording
        Those of the calibration.

    Returns
    -------
    dict of Target to ndarray, shape (...)
        Of a start whose state was read, the mean distance from the first readings.
    """
    found: dict[Target, list[FloatArray]] = {}
    for j, p in enumerate(calibration.parameters):
        if p.recording is not None:
            first = first_reading(recordings[p.recording], p.target, calibration)
            found.setdefault(p.target, []).append(values[..., j] - (first or 0.0))
    return {target: np.asarray(np.mean(parts, axis=0)) for target, parts in found.items()}


def first_reading(recording: Recording, target: Target, calibration: Calibration) -> float | None:
    """Mean of the readings of a state before the input first changes, over at most one second; None for what is no
    start, or was not read."""
    if not isinstance(target, StartTarget):
        return None
    states = {o: s.name for o in calibration.outputs if (s := state_of(calibration.model, o)) is not None}
    output = next((o for o, s in states.items() if s == target.state), None)
    values = recording.outputs.get(output) if output is not None else None
    if values is None:
        return None
    until = recording.time[0] + 1.0
    for signal in recording.inputs.values():
        changed = np.flatnonzero(np.diff(signal) != 0.0)
        before = recording.time[changed[0] + 1] if changed.size else until
        until = min(until, before if signal[0] == 0.0 else recording.time[0])
    chosen = values[(recording.time < until) | (np.arange(values.size) < 3)]
    chosen = chosen[np.isfinite(chosen)]
    return float(chosen.mean()) if chosen.size else None
