"""Cross-validation over recordings: each is left out, and predicted by a fit to the others."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.measured_data import readings_of
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit, rms_by_output
from aero_bayes.estimate.simulate import on_recordings
from aero_bayes.plain import INTERNAL, Number
from aero_bayes.progress import Progress

_REFIT_SETTINGS = FitSettings(method="local", staged=False)


@dataclass(frozen=True, eq=False)
class LeftOutPrediction:
    """A recording that was left out and predicted by a fit to the others.

    ``rms`` is the error of the prediction by output, ``rms_fitted`` that of the fit to all recordings. Outputs that no
    other recording has are not predicted."""

    rms: Mapping[str, Number]
    rms_fitted: Mapping[str, Number]
    recording: str = field(default="", metadata=INTERNAL)


def leave_one_recording_out(
    fit: Fit,
    open_simulator: OpenSimulator,
    rng: np.random.Generator,
    *,
    time_limit: float = math.inf,
    progress: Progress | None = None,
) -> tuple[LeftOutPrediction, ...]:
    """Predict each recording from a fit to the others.

    What it has alone (its delay, its initial state) these do not know: it is estimated from its beginning."""
    began = time.perf_counter()
    calibration = fit.calibration
    if len(calibration.data.experiments) < 2:
        raise InputError("leaving a recording out needs at least two")
    found: list[LeftOutPrediction] = []
    for index, name in enumerate(calibration.data.names):
        if found and (time.perf_counter() - began) * (index + 1) / index > time_limit:
            break
        if progress is not None:
            progress("recordings", index / len(calibration.data.names), name)
        others = _select(calibration, [e for e in range(len(calibration.data.names)) if e != index], fit.values)
        rest = fit_calibration(others, open_simulator, _REFIT_SETTINGS, rng)
        predicted = _predicted(fit, rest, index, open_simulator)
        found += [predicted] if predicted.rms else []  # else nothing that it measured was measured elsewhere
    return tuple(found)


def _select(calibration: Calibration, chosen: list[int], values: FloatArray) -> Calibration:
    """Return the problem of some of the recordings, with the parameters that act in them, started at ``values``."""
    items = []
    for item, value in zip(calibration.parameters, values, strict=True):
        if item.recording is None:
            items.append(replace(item, start=float(value)))
        elif item.recording in chosen:
            items.append(replace(item, start=float(value), recording=chosen.index(item.recording)))
    every = calibration.data
    data = replace(
        every,
        experiments=tuple(every.experiments[e] for e in chosen),
        names=tuple(every.names[e] for e in chosen),
        recordings=tuple(every.recordings[e] for e in chosen if every.recordings),
    )
    return replace(calibration, data=data, parameters=ParameterSet(tuple(items)))


def _predicted(fit: Fit, rest: Fit, index: int, open_simulator: OpenSimulator) -> LeftOutPrediction:
    """Return one recording, predicted by the fit to the others."""
    recording, experiment = fit.calibration.data.recordings[index], fit.calibration.data.experiments[index]
    whole, row = on_recordings(
        rest.calibration, rest.values[np.newaxis], [recording], rest.noise, open_simulator, every=True
    )
    with open_simulator(whole.problem()) as simulator:
        outputs = simulator.simulate(row).outputs[0][0]
    # Outputs that no other recording has cannot be predicted.
    known = np.isfinite(np.concatenate(rest.calibration.data.measured)).any(axis=0)
    left = readings_of(experiment) - outputs[np.searchsorted(recording.time, experiment.time)]
    error = rms_by_output([np.where(known, left, np.nan)], fit.outputs)
    own_fit = rms_by_output([fit.residuals[index]], fit.outputs)
    return LeftOutPrediction(error, {o: own_fit[o] for o in error}, fit.calibration.data.names[index])
