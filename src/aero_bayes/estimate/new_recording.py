"""Delay and initial state of a recording that was not fitted, from those that were."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording, output_noise_floor
from aero_bayes.data.initial_level import InitialLevel, initial_level
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.initial_states import state_of
from aero_bayes.simulation.interface import ProblemTarget, StartTarget


def typical(
    calibration: Calibration, values: FloatArray, recordings: Sequence[Recording]
) -> dict[ProblemTarget, FloatArray]:
    """Compute the mean over the fitted recordings of what belongs to each alone."""
    found: dict[ProblemTarget, list[tuple[FloatArray, float]]] = {}
    for j, p in enumerate(calibration.parameters):
        if p.recording is not None:
            first = first_reading(recordings[p.recording], p.target, calibration) or InitialLevel(0.0, 0.0)
            found.setdefault(p.target, []).append((values[..., j] - first.level, first.sd))
    return {target: _beyond_noise(parts) for target, parts in found.items()}


def _beyond_noise(parts: Sequence[tuple[FloatArray, float]]) -> FloatArray:
    """Compute the mean of distances, less the share that their standard deviations let expect."""
    mean = np.mean([distance for distance, _ in parts], axis=0)
    variance = sum(sd**2 for _, sd in parts) / len(parts) ** 2
    square = np.square(mean)
    share = 1.0 - np.divide(variance, square, out=np.zeros_like(square), where=square > 0.0)
    return np.asarray(mean * np.maximum(share, 0.0))


def first_reading(recording: Recording, target: ProblemTarget, calibration: Calibration) -> InitialLevel | None:
    """Return what a state was read as at the beginning of a recording; None for what is no start, or was not read."""
    started = _started(target, calibration)
    if not started:
        return None
    states = {o: s.name for o in calibration.data.outputs if (s := state_of(calibration.model, o)) is not None}
    output = next((o for o, s in states.items() if s in started), None)
    if output is None or (values := recording.outputs.get(output)) is None:
        return None
    return initial_level(values, recording.time, output_noise_floor(recording, output).sd or 0.0)


def _started(target: ProblemTarget, calibration: Calibration) -> tuple[str, ...]:
    """Return the states whose initial value a target is."""
    if isinstance(target, StartTarget):
        return (target.state,)
    return next((p.starts for p in calibration.parameters if p.target == target), ())
