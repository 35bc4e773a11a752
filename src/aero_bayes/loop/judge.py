"""Before and after: error on what was fitted and on what was not, and what the missing effect had done to the rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.check.structure import autocorrelation
from aero_bayes.data import Recording
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration, CalibrationSettings, calibrate
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.loop.recordings import Recordings
from aero_bayes.physics.kin import Family
from aero_bayes.predict.carry import first_reading, typical
from aero_bayes.simulation.interface import InputSignal, ParameterTarget, Problem, Simulator, StartTarget

FloatArray = NDArray[np.float64]

#: Share of a recording that was not fitted from which its initial states are estimated.
SETTLING = 0.05
#: Standard deviations by which one prediction is surely worse than another.
SURE = 2.0


@dataclass(frozen=True)
class Error:
    """Root mean square of a residual, its standard deviation with correlation counted, and the readings."""

    rms: float
    sd: float
    readings: int


@dataclass(frozen=True, eq=False)
class Prediction:
    """A model's prediction of whole recordings.

    ``train`` and ``test`` hold an :class:`Error` by recording and output; ``fitted`` the outputs (n,) by recording and
    output, on the recording's own samples.
    """

    train: Mapping[tuple[str, str], Error]
    test: Mapping[tuple[str, str], Error]
    fitted: Mapping[tuple[str, str], FloatArray]

    def pooled(self, role: str) -> dict[str, float]:
        """RMS by output over all recordings of a role."""
        errors = self.train if role == "train" else self.test
        squares: dict[str, list[tuple[float, int]]] = {}
        for (_, output), error in errors.items():
            squares.setdefault(output, []).append((error.rms**2 * error.readings, error.readings))
        return {o: math.sqrt(sum(s for s, _ in items) / sum(n for _, n in items)) for o, items in squares.items()}

    def uncertainty(self, role: str) -> dict[str, float]:
        """Standard deviation of :meth:`pooled`."""
        errors = self.train if role == "train" else self.test
        weights: dict[str, list[tuple[float, int]]] = {}
        for (_, output), error in errors.items():
            weights.setdefault(output, []).append((error.sd, error.readings))
        return {
            o: math.sqrt(sum((sd * n) ** 2 for sd, n in items)) / sum(n for _, n in items)
            for o, items in weights.items()
        }


@dataclass(frozen=True)
class Shift:
    """How far a parameter moved when the missing effect was added, in its own unit and in standard deviations after."""

    name: str
    before: float
    before_sd: float
    after: float
    after_sd: float

    @property
    def in_sd(self) -> float:
        return abs(self.after - self.before) / self.after_sd if self.after_sd > 0.0 else 0.0


def rms_error(residual: FloatArray, interval: float) -> Error:
    """RMS of a residual (n,) with its uncertainty; correlated readings count for less."""
    n = residual.size
    if n == 0:
        return Error(math.nan, math.nan, 0)
    rms = float(np.sqrt(np.mean(residual**2)))
    if n < 10:
        return Error(rms, rms / math.sqrt(2.0 * n), n)
    return Error(rms, 0.5 * _sd_of_mean(residual**2, interval) / max(rms, 1e-300), n)


def _sd_of_mean(series: FloatArray, interval: float) -> float:
    """Standard deviation of the mean of a series (n,), with its correlation counted."""
    n = series.size
    _, acf = autocorrelation(series, interval, min(n // 3, 2000))
    negative = np.flatnonzero(acf <= 0.0)
    last = int(negative[0]) if negative.size else acf.size
    time = max(1.0, 2.0 * float(acf[:last].sum()) - 1.0)
    return float(np.std(series)) * math.sqrt(time / n)


def surely_worse(one: Prediction, other: Prediction, recordings: Recordings) -> bool:
    """Whether a prediction misses what was not fitted by more than another in some output, by more than chance.

    Squared residuals are compared reading by reading; correlated readings count for less.
    """
    more: dict[str, float] = {}
    variance: dict[str, float] = {}
    for k, r in enumerate((*recordings.train, *recordings.test)):
        start = recordings.held_from.get(r.name, math.inf) if k < len(recordings.train) else -math.inf
        for output in (o for o in recordings.outputs if (r.name, o) in one.test and o in r.outputs):
            y = r.outputs[output]
            change = (y - one.fitted[r.name, output]) ** 2 - (y - other.fitted[r.name, output]) ** 2
            change = change[np.isfinite(change) & (r.time >= start)]
            if change.size < 10:
                continue
            sd = _sd_of_mean(change, float(np.median(np.diff(r.time))))
            more[output] = more.get(output, 0.0) + float(change.sum())
            variance[output] = variance.get(output, 0.0) + (sd * change.size) ** 2
    return any(extra > SURE * math.sqrt(variance[output]) for output, extra in more.items())


def predict(
    calibration: Calibration,
    fit: Optimum,
    recordings: Recordings,
    settings: CalibrationSettings,
    family: Family,
    open_simulator: Callable[[Problem], Simulator],
    extra: Mapping[int, InputSignal] | None = None,
) -> Prediction:
    """Run a fitted model, or a fitted relative of it in its ``family``, over whole recordings.

    A recording that was not fitted gets the fitted recordings' mean input delay. Its states start at its own first
    readings, off by as much as those of the fitted ones were; where starts are estimated, or read through a law, they
    are estimated from its first :data:`SETTLING` share. ``extra`` is an input beside the recorded ones, by the index of
    a training recording.
    """
    everything = [*recordings.train, *recordings.test]
    named = tuple(replace(r, name=f"{r.name}#{k}") for k, r in enumerate(everything))
    plain = family.plain()
    known = {v.name for v in plain.parameters}
    shared = [p for p in calibration.parameters if p.recording is None]
    new = [p for p in shared if isinstance(p.target, ParameterTarget) and p.target.name not in known]
    kept = ParameterSet(tuple(p for p in shared if p not in new))
    own = replace(
        settings, outputs=recordings.outputs, most_readings=None, standing=True, interpolation=calibration.interpolation
    )
    # Which states start at a reading is known of the model itself: a relative may read them through a law.
    fixed = {name: value for name, value in calibration.fixed.items() if name in known}
    known_as = calibrate(named, plain, kept, fixed=fixed, settings=own)
    known_as = replace(known_as, parameters=known_as.parameters.extended(new))
    whole = replace(family.on(known_as, calibration.model), fixed=calibration.fixed)
    if extra:
        experiments = list(whole.experiments)
        for e, signal in extra.items():
            experiments[e] = replace(experiments[e], inputs=(*experiments[e].inputs, signal))
        whole = replace(whole, experiments=tuple(experiments))
    row = _values(_renamed(calibration, known_as, whole), fit, known_as, everything, len(recordings.train))
    # A law at an output hides where its state started.
    hidden = [p.target for p in known_as.parameters] != [p.target for p in whole.parameters]
    if recordings.test and (settings.start == "estimated" or hidden):
        row = _settled(whole, row, fit, len(recordings.train), open_simulator)
    with open_simulator(whole.problem()) as simulator:
        found = simulator.simulate(row[np.newaxis])
    if np.any(found.outcomes[0] != 0):
        raise CannotFinishError("the fitted model cannot be simulated over the whole recordings")
    errors: tuple[dict[tuple[str, str], Error], dict[tuple[str, str], Error]] = ({}, {})
    fitted: dict[tuple[str, str], FloatArray] = {}
    for e, recording in enumerate(everything):
        interval = float(np.median(np.diff(recording.time)))
        unseen = recording.time >= recordings.held_from.get(recording.name, math.inf)
        for column, output in enumerate(recordings.outputs):
            if output not in recording.outputs:
                continue
            predicted = found.outputs[e][0, :, column]
            key = (recording.name, output)
            fitted[key] = predicted
            residual = recording.outputs[output] - predicted
            seen = np.isfinite(residual)
            if e >= len(recordings.train):
                errors[1][key] = rms_error(residual[seen], interval)
                continue
            errors[0][key] = rms_error(residual[seen & ~unseen], interval)
            if unseen.any():
                errors[1][key] = rms_error(residual[seen & unseen], interval)
    return Prediction(errors[0], errors[1], fitted)


def _renamed(calibration: Calibration, known_as: Calibration, whole: Calibration) -> Calibration:
    """A relative's calibration with its states named as in the model itself."""
    old = {there.target: here.target for here, there in zip(known_as.parameters, whole.parameters, strict=True)}
    items = tuple(replace(p, target=old.get(p.target, p.target)) for p in calibration.parameters)
    return replace(calibration, model=known_as.model, parameters=ParameterSet(items))


def _values(
    calibration: Calibration, fit: Optimum, whole: Calibration, everything: Sequence[Recording], fitted: int
) -> FloatArray:
    """SI values of all parameters of ``whole``; those of recordings that were not fitted follow the fitted ones'."""
    values = calibration.parameters.from_search(fit.coordinates)
    own = {(p.recording, p.target): v for p, v in zip(calibration.parameters, values.tolist(), strict=True)}
    follow = typical(calibration, values, everything)
    by_name = dict(zip(calibration.parameters.names, values.tolist(), strict=True))
    row = []
    for p in whole.parameters:
        if p.recording is None:
            row.append(by_name[p.name])
            continue
        value = own.get((p.recording, p.target)) if p.recording < fitted else None
        if value is None:
            first = first_reading(everything[p.recording], p.target, whole)
            start = p.start if first is None else 0.0
            value = (first or 0.0) + float(follow.get(p.target, start))
        row.append(float(np.clip(value, p.lower, p.upper)))
    return np.array(row)


def _settled(
    whole: Calibration, row: FloatArray, fit: Optimum, fitted: int, open_simulator: Callable[[Problem], Simulator]
) -> FloatArray:
    """Values with the starts of recordings that were not fitted estimated from their beginnings."""
    columns = [
        j for j, p in enumerate(whole.parameters)
        if isinstance(p.target, StartTarget) and p.recording is not None and p.recording >= fitted
    ]  # fmt: skip
    if not columns:
        return row
    beginning = whole.beginning(SETTLING)
    with open_simulator(beginning.problem()) as simulator:
        objective = Objective(beginning, simulator)
        at = whole.parameters.to_search(row)
        try:
            found = climb(objective, at, columns, noise=fit.noise, settings=ClimbSettings(hold_noise=True))
        except CannotFinishError:
            return row
    return whole.parameters.from_search(found.coordinates)


def shifts(
    parameters: ParameterSet, before: Optimum, after_parameters: ParameterSet, after: Optimum
) -> tuple[Shift, ...]:
    """Change of every parameter that both fits share, the recordings' own excepted."""
    found = []
    first, second = parameters.from_search(before.coordinates), after_parameters.from_search(after.coordinates)
    slope_1, slope_2 = parameters.jacobian(first), after_parameters.jacobian(second)
    for j in before.free:
        item = parameters.items[j]
        if item.recording is not None or item.name not in after_parameters:
            continue
        k = after_parameters.index(item.name)
        if k in after.free:
            found.append(
                Shift(
                    item.name, float(first[j]), float(before.sd(j) * slope_1[j]), float(second[k]),
                    float(after.sd(k) * slope_2[k]),
                )
            )  # fmt: skip
    return tuple(found)
