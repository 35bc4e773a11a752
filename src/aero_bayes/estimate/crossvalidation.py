"""Cross-validation over recordings: each is left out, and predicted by a fit to the others."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings, levenberg_marquardt
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit, rms_by_output
from aero_bayes.estimate.target import NoiseLayout, Target
from aero_bayes.progress import Progress
from aero_bayes.simulation.interface import DelayTarget

_REFIT_SETTINGS = FitSettings(method="local", staged=False)
#: Number of delays that are tried before the best one is refined.
_DELAY_POINTS = 21


@dataclass(frozen=True, eq=False)
class LeftOutPrediction:
    """A recording that was left out and predicted by a fit to the others.

    ``rms`` is the error of the prediction by output, ``rms_fitted`` that of the fit to all recordings. Outputs that no
    other recording has are not predicted."""

    JSON_KEYS: ClassVar = "rms rms_fitted"

    recording: str
    rms: Mapping[str, float]
    rms_fitted: Mapping[str, float]


def leave_one_recording_out(
    fit: Fit,
    open_simulator: OpenSimulator,
    rng: np.random.Generator,
    *,
    time_limit: float = math.inf,
    progress: Progress | None = None,
) -> tuple[LeftOutPrediction, ...]:
    """Predict each recording from a fit to the others.

    These do not know the nuisance parameters of the recording (its delay, its initial state), which are fitted to it
    within their priors."""
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
        alone = _select(calibration, [index], fit.values)
        alone = replace(alone, data=_with_outputs_of(alone.data, others.data))
        if not alone.data.count:
            continue  # nothing that it measured was measured elsewhere
        rest = fit_calibration(others, open_simulator, _REFIT_SETTINGS, rng)
        found.append(_predict(fit, rest, alone, index, open_simulator))
    return tuple(found)


def _with_outputs_of(data: MeasuredData, known: MeasuredData) -> MeasuredData:
    """Return the data without readings of outputs that other data have none of."""
    blind = ~np.isfinite(np.concatenate(known.measured)).any(axis=0)
    return data.with_experiments(
        replace(e, measured=np.where(blind, np.nan, y)) for e, y in zip(data.experiments, data.measured, strict=True)
    )


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


def _predict(fit: Fit, rest: Fit, alone: Calibration, index: int, open_simulator: OpenSimulator) -> LeftOutPrediction:
    """Return one recording, predicted by the fit to the others."""
    own = [j for j, p in enumerate(alone.parameters) if p.recording is not None]
    layout, split = NoiseLayout.of(rest.calibration.data, rest.noise), rest.laplace.parameters
    mean = rest.laplace.mean
    with open_simulator(alone.problem()) as simulator:
        target = Target(alone, simulator, _values(alone, rest, mean[:split]), own)
        values = _with_own_values(target, layout.unpack(mean[None, split:])[0])
        predicted = simulator.simulate(values[None]).outputs[0][0]
    error = rms_by_output([alone.data.measured[0] - predicted], fit.outputs)
    own_fit = rms_by_output([fit.residuals[index]], fit.outputs)
    return LeftOutPrediction(alone.data.names[0], error, {o: own_fit[o] for o in error})


def _values(alone: Calibration, rest: Fit, coordinates: FloatArray) -> FloatArray:
    """Compute SI values (p,) for a recording left out: shared ones from the others' posterior, own ones at a start."""
    items = rest.calibration.parameters.items
    searched = ParameterSet(tuple(items[j] for j in rest.free))
    drawn = dict(zip(searched.names, searched.from_search(coordinates).tolist(), strict=True))
    shared = {p.name: drawn.get(p.name, float(rest[p.name])) for p in alone.parameters if p.recording is None}
    return np.array([shared.get(p.name, p.start) for p in alone.parameters])


def _with_own_values(target: Target, noise: FloatArray) -> FloatArray:
    """Values (p,) with the nuisances of a recording fitted to it."""
    if not target.free:
        return target.base
    start = target.parameters.to_search(target.base[list(target.free)])
    low, high = target.box
    delays = [k for k, p in enumerate(target.parameters) if isinstance(p.target, DelayTarget)]
    if delays:
        trial = np.tile(start, (_DELAY_POINTS, 1))
        for k in delays:
            trial[:, k] = np.linspace(low[k], high[k], _DELAY_POINTS)
        start = trial[int(np.argmin(target.cost(trial, noise[None])))]
    found = levenberg_marquardt(target.cost_function(noise[None]), start, low, high)
    values: FloatArray = target.values((start if found.quadratic is None else found.point)[None])[0]
    return values
