"""Channels that were read in another way than they were written: sign, unit, order, clock, and values beside them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.find_table import DataFinding, FindingKind
from aero_bayes.data.recording import Recording
from aero_bayes.display import with_unit
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.misaligned import Misalignment, misalignments
from aero_bayes.estimate.other_values import OtherValues, other_values
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
    others = map(_with_values, other_values(fit, open_simulator))
    for reading in (*readings, *map(_clock, misalignments(fit)), *others):
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
            if structured and reading.kind == "value":
                continue  # other values take up a part of whatever is missing
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
        # Those of clocks and values were chosen by what is left of the squares.
        most = None if kind in ("clock", "value") else MAX_TRIED
        yield from ((reading, calibration) for _, reading, calibration in own[:most])


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


def _with_values(found: OtherValues) -> _Reading:
    """Return the reading with other values of parameters."""
    return _Reading("value", found.names, found.what, found.done, calibrated=found.applied)


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
