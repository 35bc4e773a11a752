"""Outliers: single readings that are far off a fit and off the readings beside them.

They are told from heavy tails of the noise, which have as many readings a little too far off as very far ones, and from
what a model lacks, which lasts longer than a reading or follows a change of an input.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import MAD_TO_SD, Mask, after_changes, runs
from aero_bayes.data.find_table import DataFinding, FindingKind
from aero_bayes.data.noise import quantisation_step
from aero_bayes.data.recording import Recording
from aero_bayes.data.screen import hide
from aero_bayes.display import with_unit
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.misaligned import Misalignment, misalignments
from aero_bayes.estimate.result import Fit
from aero_bayes.modelica.units import conversion
from aero_bayes.simulation.interface import Outcome

#: Units that loggers write, SI ones among them for models that are not in SI.
UNITS = (
    "K", "degC", "degF", "rad", "deg", "rev", "rad/s", "deg/s", "rpm", "m", "mm", "cm", "m/s", "mm/s", "km/h", "g",
    "m/s2", "Pa", "kPa", "mbar", "bar", "psi", "N", "kN", "mN", "N.m", "mN.m", "W", "kW", "mW", "A", "mA", "V", "mV",
    "kg/s", "kg/min", "kg/h", "g/s", "m3/s", "l/s", "l/min", "m3/h", "kg", "1", "%", "mol", "mmol",
)  # fmt: skip
#: Units of a clock that was read as seconds.
CLOCKS = {"ms": 1e-3, "us": 1e-6}
#: Residual, as a share of what an output moves, from which a fit is so poor that a channel may be another one.
POOR_SHARE = 0.1
#: Factor by which the right reading makes a residual smaller at least, and where only noise is left then;
#: no output gets worse. Parameters take up much of a clock's error.
MIN_FACTOR, MIN_CLEAN_FACTOR, MIN_WORST = 3.0, 1.5, 0.9
#: Factor from which no other reading is tried, where only noise is left.
SURE_FACTOR = 20.0
#: Most readings of a kind that are tried by a fit, and samples of a recording that it is to.
MAX_TRIED, SAMPLES = 3, 1000


@dataclass(frozen=True)
class _Reading:
    """Another way to read the data."""

    kind: FindingKind
    channel: str
    what: str
    done: str
    recorded: Callable[[Recording], Recording] = lambda recording: recording
    calibrated: Callable[[Calibration], Calibration] = lambda calibration: calibration


def with_misread_finding(
    fit: Fit,
    calibrated: Callable[[Sequence[Recording]], Calibration],
    fitted: Callable[[Calibration], Fit],
    open_simulator: OpenSimulator,
) -> Fit:
    """Return the fit with a finding of its data where it is poor, and good with the data read in another way."""
    data = fit.calibration.data
    structured = any(n.model_error or n.kind == "ou" for n in fit.noise.values())
    if not structured or fit.calibration.simulated.process is not None:
        return fit
    tried: list[tuple[float, _Reading, Calibration]] = []
    poor = max(_shares(data, fit.fitted).values(), default=0.0) > POOR_SHARE
    readings = [r for r in _readings(fit) if poor or r.kind == "swap"]  # two channels may be nearly alike
    for reading in (*readings, *map(_clock, misalignments(fit))):
        with suppress(InputError, CannotFinishError):
            calibration = reading.calibrated(calibrated([reading.recorded(r) for r in data.recordings]))
            calibration = replace(calibration, data=calibration.data.thinned(SAMPLES))
            tried.append((_nearest(calibration, fit, open_simulator), reading, calibration))
    best: tuple[float, _Reading, dict[str, tuple[float, float]]] | None = None
    sure = False
    for reading, calibration in _most_promising(tried):
        if sure:
            break
        with suppress(CannotFinishError):
            again = fitted(calibration)
            change = _change(fit, again)
            gains = [before / after for before, after in change.values()] or [0.0]
            if max(gains) < MIN_CLEAN_FACTOR or min(gains) < MIN_WORST:
                continue
            structured = any(n.model_error for n in again.noise.values())
            sure = sure or (max(gains) > SURE_FACTOR and not structured)
            # All outputs count: one alone may be moved to where it fits best.
            total = math.prod(gains)
            if (max(gains) > MIN_FACTOR or not structured) and (best is None or total > best[0]):
                best = total, reading, change
    return fit if best is None else _told(fit, best[1], best[2])


def _most_promising(tried: list[tuple[float, _Reading, Calibration]]) -> Iterator[tuple[_Reading, Calibration]]:
    """Yield the readings to fit, those first that leave least before: what parameters change differs by kind."""
    kinds = dict.fromkeys(_kind_of(reading) for _, reading, _ in tried)
    for kind in kinds:
        own = sorted((one for one in tried if _kind_of(one[1]) == kind), key=lambda one: one[0])
        # Those of clocks were chosen by what is left of the squares.
        yield from ((reading, calibration) for _, reading, calibration in own[: None if kind == "clock" else MAX_TRIED])


def _kind_of(reading: _Reading) -> str:
    return "time" if reading.channel == "time" else reading.kind


def _told(fit: Fit, reading: _Reading, change: dict[str, tuple[float, float]]) -> Fit:
    """Return the fit with the finding."""
    data, units = fit.calibration.data, fit.calibration.model.units
    output = max(change, key=lambda o: change[o][0] / change[o][1])
    before, after = (with_unit(f"{size:.2g}", units.get(output, "")) for size in change[output])
    where = "all recordings" if len(data.recordings) > 1 else data.names[0]
    what = f"{reading.what}, the residual of {output} falls from {before} to {after}."
    finding = DataFinding(reading.kind, data.names[0], reading.channel, what, where, reading.done, False)
    told = tuple(replace(r, findings=(finding, *r.findings)) for r in data.recordings)
    return replace(fit, calibration=replace(fit.calibration, data=replace(data, recordings=told)))


def _readings(fit: Fit) -> list[_Reading]:
    """List each channel with its sign turned and in each unit of its dimension, exchanged pairs, and clocks."""
    model, data = fit.calibration.model, fit.calibration.data
    inputs, outputs = [v for v in model.inputs], [v for v in model.outputs if v.name in data.outputs]
    found = []
    for v in (*inputs, *outputs):
        if v.unit != "K":
            done = f"Turn it by [data.columns.{v.name}] scale = -1.0."
            what = f"{v.name} looks counted the other way round: with its sign turned"
            found.append(_Reading("sign", v.name, what, done, partial(_converted, v.name, -1.0, 0.0)))
        for unit in UNITS:
            change = conversion(unit, v.unit) if v.unit else None
            if change is not None and not (math.isclose(change[0], 1.0) and change[1] == 0.0):
                done = f'Say so by [data.columns.{v.name}] unit = "{unit}".'
                found.append(_Reading(
                    "unit", v.name, f"{v.name} looks like {unit}: read as such", done,
                    partial(_converted, v.name, *change),
                ))  # fmt: skip
    for one, other in (*combinations(inputs, 2), *combinations(outputs, 2)):
        if one.unit == other.unit:
            done = f"Exchange them by [data.columns.{one.name}] and [data.columns.{other.name}]."
            what = f"{one.name} and {other.name} look exchanged: each read as the other"
            found.append(_Reading("swap", one.name, what, done, partial(_exchanged, one.name, other.name)))
    for unit, factor in CLOCKS.items():
        done = f'Say so by [data.columns.time] unit = "{unit}".'
        found.append(_Reading("unit", "time", f"time looks like {unit}: read as such", done, partial(_timed, factor)))
    return found


def _columns(recording: Recording, change: Callable[[dict[str, FloatArray]], dict[str, FloatArray]]) -> Recording:
    inputs, outputs = change(dict(recording.inputs)), change(dict(recording.outputs))
    return replace(recording, inputs=inputs, outputs=outputs, sha256="")


def _converted(channel: str, factor: float, offset: float, recording: Recording) -> Recording:
    return _columns(recording, lambda c: {n: factor * v + offset if n == channel else v for n, v in c.items()})


def _exchanged(one: str, other: str, recording: Recording) -> Recording:
    names = {one: other, other: one}
    return _columns(recording, lambda c: {n: c.get(names.get(n, n), v) for n, v in c.items()})


def _timed(factor: float, recording: Recording) -> Recording:
    return replace(recording, time=factor * recording.time, sha256="")


def _clock(found: Misalignment) -> _Reading:
    """Return the reading with outputs on the inputs' clock."""
    return _Reading("clock", found.output, found.what, found.done, calibrated=found.aligned)


def _change(fit: Fit, again: Fit) -> dict[str, tuple[float, float]]:
    """Compute RMS residuals before and after, in the unit of the output, which reading may have changed."""
    before, after = _shares(fit.calibration.data, fit.fitted), _shares(again.calibration.data, again.fitted)
    rms = fit.rms
    return {o: (rms[o], rms[o] * max(after[o] / before[o], 1e-12)) for o in before if o in after and before[o] > 0.0}


def _nearest(calibration: Calibration, fit: Fit, open_simulator: OpenSimulator) -> float:
    """Return what start values or fitted ones leave of a calibration, whichever is less."""
    parameters = calibration.parameters
    low, high = (np.array([getattr(p, side) for p in parameters]) for side in ("lower", "upper"))
    same = np.array([float(fit[p.name]) if p.recording is None and p.name in fit else p.start for p in parameters])
    rows = np.array([parameters.start, np.clip(same, low, high)])
    with open_simulator(calibration.problem()) as simulator:
        runs = simulator.simulate(rows)
    shares = [
        max(_shares(calibration.data, [y[k] for y in runs.outputs]).values(), default=math.inf)
        for k in range(len(rows))
        if np.all(runs.outcomes[k] == Outcome.OK)
    ]
    return min(shares, default=math.inf)


def _shares(data: MeasuredData, outputs: Sequence[FloatArray]) -> dict[str, float]:
    """Compute the RMS residual of each output as a share of the standard deviation of its readings."""
    shares = {}
    for k, name in enumerate(data.outputs):
        read = np.concatenate([y[:, k] for y in data.measured])
        left = read - np.concatenate([y[:, k] for y in outputs])
        seen = np.isfinite(left)
        if seen.any() and (size := float(np.std(read[seen]))) > 0.0:
            shares[name] = float(np.sqrt(np.mean(left[seen] ** 2))) / size
    return shares


#: Distance from the residuals around it, in robust standard deviations, above which a reading is an outlier (1 in 5e8
#: of normal ones), and above which it is unusual (1 in 2,000).
OUTLIER, UNUSUAL = 6.0, 3.5
#: Share of normal readings that may be unusual, twice what is expected.
NORMAL_UNUSUAL = 1e-3
#: Smallest outlier as a share of the output's range: smaller ones decide nothing.
MIN_SIZE = 0.01
#: Readings around one that say what is usual there, most outliers in a row, and largest share of all readings.
AROUND, MOST_IN_A_ROW, MAX_SHARE = 7, 2, 0.1
#: Share of its distance from the fit that an outlier is off the readings beside it, too.
MIN_OFF_NEIGHBOURS = 0.5
#: After a change of an input, an outlier is a single reading that is off by more than what the fit moves within so many
#: readings, times this: a delay that the model lacks leaves no more.
BESIDE, MIN_TIMES_MOVED = 5, 2.0
#: Fewest readings that tell what is usual.
MIN_OUTLIER_READINGS = 30


def without_outliers(
    data: MeasuredData, fitted: Sequence[FloatArray], kept_whole: Collection[str] = ()
) -> tuple[MeasuredData, tuple[DataFinding, ...]]:
    """Return the data without the readings that are outliers of a fit, and what is told of them.

    Outputs that are ``kept_whole`` are not looked at."""
    experiments, recordings = list(data.experiments), list(data.recordings)
    if not recordings:
        return data, ()
    for k, (experiment, measured) in enumerate(zip(data.experiments, data.measured, strict=True)):
        recording = recordings[k]
        rows = np.searchsorted(recording.time, experiment.time)
        inputs = {name: values[rows] for name, values in recording.inputs.items()}
        kept = measured.copy()
        for column, name in enumerate(experiment.outputs):
            if name in kept_whole:
                continue
            found = outlier_rows(measured[:, column], fitted[k][:, column], inputs)
            if not found.any():
                continue
            kept[found, column] = np.nan
            recording = _hidden(recording, name, rows[found], np.abs(measured - fitted[k])[found, column])
        if recording is not recordings[k]:
            recordings[k], experiments[k] = recording, replace(experiment, measured=kept)
    findings = tuple(
        f for new, old in zip(recordings, data.recordings, strict=True) for f in new.findings[len(old.findings) :]
    )
    if not findings:
        return data, ()
    return replace(data, experiments=tuple(experiments), recordings=tuple(recordings)), findings


def outlier_rows(measured: FloatArray, fitted: FloatArray, inputs: Mapping[str, FloatArray]) -> Mask:
    """Mark rows of an output whose readings are outliers of a fit."""
    none = np.zeros(measured.size, dtype=bool)
    at = np.flatnonzero(np.isfinite(measured))
    if at.size < MIN_OUTLIER_READINGS:
        return none
    residual, seen = measured[at] - fitted[at], measured[at]
    off = residual - median_filter(residual, AROUND, mode="nearest")
    # Rounding alone spreads readings by this; the median of what is left of it may be anything below.
    least = (quantisation_step(seen) or 0.0) / math.sqrt(12.0)
    size = max(MAD_TO_SD * float(np.median(np.abs(off))), least)
    far = np.abs(off) > max(OUTLIER * size, MIN_SIZE * float(np.ptp(fitted[at])), 1e-300)
    beside = np.abs(seen - median_filter(seen, AROUND, mode="nearest"))
    far &= beside > MIN_OFF_NEIGHBOURS * np.abs(off)
    moved = maximum_filter1d(fitted[at], BESIDE) - minimum_filter1d(fitted[at], BESIDE)
    near = after_changes(inputs)[at] if inputs else none[at]
    far &= ~near | (np.abs(off) > MIN_TIMES_MOVED * moved)
    every = far.copy()
    for start, stop in runs(far):
        too_long = stop - start > (1 if near[start:stop].any() else MOST_IN_A_ROW)
        if too_long or not _off_the_curve(residual, off, start, stop):
            far[start:stop] = False
    # Where most of what is far off is no outlier, the fit is poor, and says nothing of the rest.
    unusual = int(((np.abs(off) > UNUSUAL * size) & (np.abs(off) <= OUTLIER * size)).sum()) + int((every & ~far).sum())
    if not far.any() or every.mean() > MAX_SHARE or far.sum() <= unusual - NORMAL_UNUSUAL * at.size:
        return none
    found = none.copy()
    found[at[far]] = True
    return found


def _off_the_curve(residual: FloatArray, off: FloatArray, start: int, stop: int) -> bool:
    """Return whether a run of readings is off the cubic through the two residuals on either side of it.

    What a model lacks near a resonance has crests of a few readings; these lie on the curve, outliers do not."""
    beside = np.array([k for k in (start - 2, start - 1, stop, stop + 1) if 0 <= k < residual.size])
    rows = np.arange(start, stop)
    middle = 0.5 * (start + stop - 1)
    curve = np.polynomial.Polynomial.fit(beside - middle, residual[beside], beside.size - 1)
    distance = np.abs(residual[rows] - curve(rows - middle))
    return bool(np.any(distance > MIN_OFF_NEIGHBOURS * np.abs(off[rows])))


def _hidden(recording: Recording, name: str, rows: np.ndarray, distances: FloatArray) -> Recording:
    """Return the recording without the outliers, one finding for all that were ever found of an output."""
    mask = np.zeros(recording.rows, dtype=bool)
    mask[rows] = True
    unit, share = recording.units.get(name, ""), mask.sum() / np.isfinite(recording.outputs[name]).sum()
    size = with_unit(f"{float(np.median(distances)):.3g}", unit)
    what = f"{int(mask.sum())} readings of {name} ({share:.2%}) are outliers, off the fit by about {size}."
    return hide(recording, name, mask, "outliers", what, "They are not fitted.")
