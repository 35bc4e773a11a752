"""Data that were read in another way than they were written (sign, unit, order, clock), and values held wrongly.

Each other way is a calibration of its own. Where a fit is poor, those that promise most are fitted: the best is told.
Rough least squares come first, since most come nowhere near what they have to gain.

Clocks are looked for in the fitted trajectory: it is compared with the readings at other times, its parameters moved by
one Newton step. An output that comes late is no fault of a clock: sensors lag and inputs are delayed. A clock that runs
at another rate is told where the inputs keep changing, since a single response runs faster with other parameters, too.
Of parameters that may have another value, or one in each recording, one Newton step from the fit says which to try.
So it does of constants at a channel, which are tried where no discrete reading explains all. The pull of the priors and
means over intervals are looked at first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import combinations, islice

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.display import join_names
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration, for_recordings
from aero_bayes.estimate.held_values import held_parameters
from aero_bayes.estimate.interval_means import without_means
from aero_bayes.estimate.levenberg_marquardt import LocalSettings, Stop
from aero_bayes.estimate.local_fit import LocalFitSettings, OpenSimulator, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.other_reading import (
    MIN_CLEAN_FACTOR,
    MIN_WORST,
    Reading,
    Refits,
    Tried,
    after_step,
    changed_columns,
    converted,
    gains_of,
    residual_shares,
    scaled_rows,
    with_finding,
)
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.prior_pull import without_wrong_prior
from aero_bayes.estimate.residual_tests import structured_residuals
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.zero_shift import without_constant
from aero_bayes.modelica.units import conversion
from aero_bayes.simulation.interface import Outcome, ParameterTarget

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
#: Factors that are left out where a unit is taken for another one that is not declared.
FACTORS = {"2 pi": 2.0 * math.pi, "1000": 1e3, "1e5": 1e5, "9.81": 9.81, "3.6": 3.6, "60": 60.0}
#: Factor by which the right reading makes a residual smaller at least. Parameters take up much of a clock's error.
MIN_FACTOR = 3.0
#: Factor from which no other reading is tried, where only noise is left.
SURE_FACTOR = 20.0
#: Most readings of a kind that are tried by a fit, most of clocks, and samples of a recording that it is to.
MAX_TRIED, MOST_CLOCKS, SAMPLES = 3, 6, 1000
#: A first fit of each reading: most steps, and nats a reading by which one has to lower the cost (a percent of the
#: residual). It goes on to a whole fit where its steps did not end so, or within a factor of the gain that counts.
MOST_STEPS, MIN_STEP_GAIN, NEAR = 30, 0.01, 0.8
#: Samples by which an output may be ahead, and shares by which a clock may be off.
MAX_AHEAD, RATES = 4, tuple(np.geomspace(5e-5, 0.05, 31).tolist())
#: Readings of a series in which a clock is looked for, and share of the squares that has to go before a refit tries it
#: (the parameters have taken up much of it, and come back by more than one step).
MOST_READINGS, MIN_GONE = 2000, 0.1
#: Parts of a recording in each of which an input has to change before its clock is compared with the outputs'.
PARTS = 3
#: Most held parameters that are looked at.
MOST_HELD = 20


def with_misread_finding(fit: Fit, refits: Refits) -> Fit:
    """Return the fit with a finding of its data where it is poor, and good with the data read in another way."""
    data = fit.calibration.data
    structured = any(n.model_error or n.kind == "ou" for n in fit.noise.values())
    if fit.calibration.process is not None or not (structured or structured_residuals(fit.reports)):
        return fit
    if (told := without_wrong_prior(fit, refits)) is not None:
        return told
    if (told := without_means(fit, refits)) is not None:
        return told
    if not structured:
        found = without_constant(fit, refits)
        return fit if found is None else found
    tried: list[tuple[float, Reading, Calibration]] = []
    poor = max(residual_shares(data, fit.fitted).values(), default=0.0) > POOR_SHARE
    readings = [r for r in _readings(fit) if poor or r.kind == "swap"]  # two channels may be nearly alike
    for reading in (*readings, *_clocks(fit), *_other_values(fit, refits.open)):
        with suppress(InputError, CannotFinishError):
            calibration = reading.calibrated(refits.calibrated([reading.recorded(r) for r in data.recordings]))
            calibration = replace(calibration, data=calibration.data.thinned(SAMPLES))
            tried.append((_nearest(calibration, fit, refits.open), reading, calibration))
    best: tuple[float, Reading, Calibration] | None = None
    clean = False
    promising = [*_most_promising(tried)]
    near = partial(_comes_near, fit, refits.open)
    ends = refits.each_fitted([calibration for _, calibration in promising], near, partial(_what_changes, fit))
    for (reading, calibration), end in zip(promising, ends, strict=True):
        gains, structured = end if end is not None else ([0.0], True)
        if max(gains) < MIN_CLEAN_FACTOR or min(gains) < MIN_WORST:
            continue
        if structured and reading.kind in ("value", "factor"):
            continue  # other values and factors take up a part of whatever is missing
        # All outputs count: one alone may be moved to where it fits best.
        total = math.prod(gains)
        if (max(gains) > MIN_FACTOR or not structured) and (best is None or total > best[0]):
            best, clean = (total, reading, calibration), not structured
        if max(gains) > SURE_FACTOR and not structured:
            break
    if not clean and (told := without_constant(fit, refits)) is not None:
        return told
    # Fitted once more: a fit stays in the process in which it was made.
    return fit if best is None else with_finding(fit, best[1], refits.fitted(best[2]))


def _what_changes(fit: Fit, again: Fit) -> Tried:
    """Return what a fit of another reading makes smaller, and whether it leaves structure."""
    return gains_of(fit, again), any(n.model_error for n in again.noise.values())


def _comes_near(fit: Fit, open_simulator: OpenSimulator, calibration: Calibration) -> bool:
    """Return whether least squares, from where a whole fit starts, come near the gain that counts.

    They have no noise, stages and intervals to find, and take a tenth of the time."""
    parameters = calibration.parameters
    free = [j for j, p in enumerate(parameters) if not p.free_if_identified]
    with open_simulator(calibration.problem()) as simulator:
        objective = Objective(calibration, simulator)
        least = MIN_STEP_GAIN * objective.readings
        few = LocalSettings(MOST_STEPS, least, min_noise_gain=least, max_rejections=6, min_decrease=least)
        squares = LocalFitSettings(few, prior=fit.settings.cost == "posterior").least_squares(objective.outputs)
        end = local_fit(objective, parameters.to_search(parameters.start), free, settings=squares)
        outputs = objective.predictions(parameters.from_search(end.coordinates))
    gains = gains_of(fit, replace(fit, calibration=calibration, fitted=outputs))
    near = max(gains) >= NEAR * MIN_CLEAN_FACTOR and min(gains) >= NEAR * MIN_WORST
    return near or end.reason is Stop.ITERATION_LIMIT


def _most_promising(tried: list[tuple[float, Reading, Calibration]]) -> Iterator[tuple[Reading, Calibration]]:
    """Yield the readings to fit, those first that leave least before: what parameters change differs by kind."""
    kinds = dict.fromkeys(_kind_of(reading) for _, reading, _ in tried)
    for kind in kinds:
        own = sorted((one for one in tried if _kind_of(one[1]) == kind), key=lambda one: one[0])
        # Those of clocks and values were chosen by what is left of the squares.
        most = None if kind in ("clock", "value") else MAX_TRIED
        yield from ((reading, calibration) for _, reading, calibration in own[:most])


def _kind_of(reading: Reading) -> str:
    return "time" if reading.channel == "time" else reading.kind


def _readings(fit: Fit) -> list[Reading]:
    """List each channel with its sign turned and in each unit of its dimension, exchanged pairs, and clocks."""
    model, data = fit.calibration.model, fit.calibration.data
    inputs, outputs = (
        [v for v in model.inputs if v.kind == "real"],
        [v for v in model.outputs if v.name in data.outputs],
    )
    found = []
    for v in (*inputs, *outputs):
        if v.unit != "K":
            done = f"Turn it by [data.columns.{v.name}] scale = -1.0."
            what = f"{v.name} looks counted the other way round: with its sign turned"
            found.append(Reading("sign", v.name, what, done, partial(converted, v.name, -1.0, 0.0)))
        for unit in UNITS:
            change = conversion(unit, v.unit) if v.unit else None
            if change is not None and not (math.isclose(change[0], 1.0) and change[1] == 0.0):
                done = f'Say so by [data.columns.{v.name}] unit = "{unit}".'
                found.append(Reading(
                    "unit", v.name, f"{v.name} looks like {unit}: read as such", done,
                    partial(converted, v.name, *change),
                ))  # fmt: skip
        for text, factor in FACTORS.items():
            for sign, how in ((1.0, "small"), (-1.0, "large")):
                what = f"{v.name} looks too {how} by a factor of {text}: with it"
                done = f"Say its unit, or give it by [data.columns.{v.name}] scale = {factor**sign:.6g}."
                found.append(Reading("factor", v.name, what, done, partial(converted, v.name, factor**sign, 0.0)))
    for one, other in (*combinations(inputs, 2), *combinations(outputs, 2)):
        if one.unit == other.unit:
            done = f"Exchange them by [data.columns.{one.name}] and [data.columns.{other.name}]."
            what = f"{one.name} and {other.name} look exchanged: each read as the other"
            found.append(Reading("swap", one.name, what, done, partial(_exchanged, one.name, other.name)))
    for unit, factor in CLOCKS.items():
        done = f'Say so by [data.columns.time] unit = "{unit}".'
        found.append(Reading("unit", "time", f"time looks like {unit}: read as such", done, partial(_timed, factor)))
    return found


def _exchanged(one: str, other: str, recording: Recording) -> Recording:
    names = {one: other, other: one}
    return changed_columns(recording, lambda c: {n: c.get(names.get(n, n), v) for n, v in c.items()})


def _timed(factor: float, recording: Recording) -> Recording:
    return replace(recording, time=factor * recording.time, sha256="")


def _nearest(calibration: Calibration, fit: Fit, open_simulator: OpenSimulator) -> float:
    """Return what start values or fitted ones leave of a calibration, whichever is less."""
    parameters = calibration.parameters
    low, high = (np.array([getattr(p, side) for p in parameters]) for side in ("lower", "upper"))
    same = np.array([float(fit[p.name]) if p.recording is None and p.name in fit else p.start for p in parameters])
    rows = np.array([parameters.start, np.clip(same, low, high)])
    with open_simulator(calibration.problem()) as simulator:
        runs = simulator.simulate(rows)
    shares = [
        max(residual_shares(calibration.data, [y[k] for y in runs.outputs]).values(), default=math.inf)
        for k in range(len(rows))
        if np.all(runs.outcomes[k] == Outcome.OK)
    ]
    return min(shares, default=math.inf)


def _clocks(fit: Fit) -> list[Reading]:
    """List outputs that are ahead, and clocks that are off, where the squares of an output fall: the best first."""
    data = fit.calibration.data
    if not any(e.inputs for e in data.experiments):
        return []
    interval = min(data.intervals)
    found: list[tuple[float, str, float, int]] = []  # share of the squares, output (empty: all), rate, samples ahead
    own_clocks = {o: {k for k, s in enumerate(fit.series) if s.output == o} for o in data.outputs}
    for output, own in own_clocks.items():
        found += [(_left(fit, 0.0, n * interval, own), output, 0.0, n) for n in range(1, MAX_AHEAD + 1)]
    if _inputs_keep_changing(fit):
        every = {"": set(range(len(fit.series)))}
        for output, moved in (every | own_clocks if len(own_clocks) > 1 else every).items():
            rates = [(_left(fit, sign * rate, 0.0, moved), sign * rate) for rate in RATES for sign in (-1.0, 1.0)]
            _, rate = min(rates)
            finer = [(_left(fit, r, 0.0, moved), r) for r in (rate * np.linspace(0.8, 1.25, 19)).tolist()]
            left, rate = min(finer)
            found.append((left, output, rate, 0))
    found.sort(key=lambda one: one[0])
    likely = [one for one in found if one[0] < 1.0 - MIN_GONE]
    early = {output for _, output, rate, _ in likely if not rate}
    first = next((output for _, output, _, _ in likely if output in early), None)
    # All shifts of an output: the step from a fit that has taken up much of a shift tells little of how large it is.
    shifts = [one for one in found if not one[2] and one[1] == first]
    chosen = [*shifts, *(one for one in likely if one[2])][:MOST_CLOCKS]
    return [_clock(output, rate, samples, interval) for _, output, rate, samples in chosen]


def _clock(output: str, rate: float, samples: int, interval: float) -> Reading:
    """Return the reading with outputs on the inputs' clock: one of them, or all (empty)."""
    ahead = samples * interval
    if rate:
        side, whose = "slow" if rate > 0.0 else "fast", output or "the outputs"
        what = f"The clock of {whose} looks {100.0 * abs(rate):.2g} % {side} beside that of the inputs: with one clock"
        done = "Put both on one clock: each of two loggers has its own."
    else:
        what = f"{output} looks {ahead:.3g} s ({samples} samples) ahead of the inputs: moved back"
        done = f"Shift its column, or let the fit do so by [fit] max_input_delay = -{1.5 * ahead:.2g}."
    return Reading("clock", output, what, done, calibrated=partial(_aligned, output, rate, ahead))


def _aligned(output: str, rate: float, ahead: float, calibration: Calibration) -> Calibration:
    """Return the calibration with inputs on the outputs' clock, or with an output's readings at their times."""
    experiments = []
    for e in calibration.data.experiments:
        begin = e.time[0]
        if not output:
            moved = tuple(replace(s, time=begin + (s.time - begin) / (1.0 + rate)) for s in e.inputs)
            experiments.append(replace(e, inputs=moved))
            continue
        assert e.measured is not None
        measured, column = e.measured.copy(), e.outputs.index(output)
        seen = np.isfinite(measured[:, column])
        stamps = begin + (e.time[seen] - begin - ahead) / (1.0 + rate)
        if seen.any():
            values = measured[seen, column]
            measured[seen, column] = np.interp(stamps, e.time[seen], values, left=np.nan, right=np.nan)
        experiments.append(replace(e, measured=measured))
    return replace(calibration, data=calibration.data.with_experiments(experiments))


def _inputs_keep_changing(fit: Fit) -> bool:
    """Return whether an input changes in each part of the longest recording."""
    longest = max(fit.calibration.data.experiments, key=lambda e: float(e.time[-1] - e.time[0]))
    edges = np.linspace(longest.time[0], longest.time[-1], PARTS + 1)
    return any(np.all(np.histogram(s.time[1:][np.diff(s.values) != 0.0], edges)[0] > 0) for s in longest.inputs)


def _left(fit: Fit, rate: float, ahead: float, moved: set[int]) -> float:
    """Compute the share of an output's squares that is left at best, with some series at other times.

    The parameters take one Newton step of least squares."""
    slopes, predicted = fit.optimum.evaluation.slopes, fit.optimum.evaluation.predicted
    assert slopes is not None
    rows, columns = [], []
    for k, series in enumerate(fit.series):
        every = -(-series.sampling.size // MOST_READINGS)
        curves = [predicted[k], *slopes[k]]
        if k in moved:
            time = series.sampling.time
            at = time[0] + (time[::every] - time[0]) * (1.0 + rate) + ahead
            curves = [np.interp(at, time, curve) for curve in curves]
        else:
            curves = [curve[::every] for curve in curves]
        sd = fit.noise[series.output].sd
        rows.append((series.measured[::every] - curves[0]) / sd)
        columns.append(np.array(curves[1:]).reshape(-1, rows[-1].size) / sd)
    residual, design = np.concatenate(rows), np.concatenate(columns, axis=1)
    after = np.split(after_step(design, residual), np.cumsum([r.size for r in rows])[:-1])
    # The present residual is of unit size in each output.
    return min(
        float(np.mean(np.concatenate([r for s, r in zip(fit.series, after, strict=True) if s.output == o]) ** 2))
        for o in {s.output for s in fit.series}
    )


def _other_values(fit: Fit, open_simulator: OpenSimulator) -> list[Reading]:
    """List changes of values that leave least of the squares, the best of each kind first."""
    calibration, count = fit.calibration, len(fit.calibration.parameters)
    items, held = calibration.parameters.items, _held(fit.calibration)
    whole = _searched(calibration, held, held)
    with open_simulator(whole.problem()) as simulator:
        at = whole.parameters.to_search(np.concatenate([fit.values, [p.start for p in held]]))
        run = Objective(whole, simulator).evaluate(at, [*fit.free, *range(count, count + len(held))])
    if run is None or run.slopes is None:
        return []
    residual, slopes = scaled_rows(fit.series, run, fit.noise)
    whose = [calibration.data.recordings[s.experiment] for s in fit.series]
    names = [r.part_of or r.name for r in whose]
    runs = np.repeat([sorted(set(names)).index(name) for name in names], [s.sampling.size for s in fit.series])

    def left(extra: FloatArray) -> float:
        rest = after_step(np.vstack([slopes[: len(fit.free)], extra]), residual)
        return float(rest @ rest)

    columns = {(p,): len(fit.free) + k for k, p in enumerate(held)}
    tried = [(left(slopes[k : k + 1]), _freed(one)) for one, k in columns.items()]
    given = [k for k, p in enumerate(held) if p.name in calibration.fixed]
    if len(given) > 1:
        tried.append((left(slopes[[len(fit.free) + k for k in given]]), _freed(tuple(held[k] for k in given))))
    own = []
    if len(set(names)) > 1:
        splits = [(k, _split(one, True)) for one, k in columns.items()]
        splits += [(k, _split((items[j],), False)) for k, j in enumerate(fit.free) if _is_shared(items[j])]
        own = [(left((runs == np.unique(runs)[:, None]) * slopes[k]), one) for k, one in splits]
    return [one for kind in (tried, own) for _, one in sorted(kind, key=lambda pair: pair[0])[:MAX_TRIED]]


def _freed(held: tuple[Parameter, ...]) -> Reading:
    """Return the reading with parameters fitted that were held."""
    names, alone = join_names([p.name for p in held]), len(held) == 1
    what = f"{names} is held at a value" if alone else f"{names} are held at values"
    what = f"{what} that may be wrong: with {'it' if alone else 'these'} fitted, too"
    done = f"Fit {'it by' if alone else 'them, as by'} [parameters] {held[0].name} = {{free = true}}."
    return Reading("value", names, what, done, calibrated=partial(_with_values, held, False))


def _split(parameter: tuple[Parameter], held: bool) -> Reading:
    """Return the reading with a value of a parameter in each recording."""
    name = parameter[0].name
    what = f"{name} seems to differ from recording to recording: with a value of its own in each"
    fitted = f"by [parameters] {name} = {{free = true, per_recording = true}}"
    done = f"If it is known, give value = {{NAME = ...}}; else fit it {fitted}." if held else f"Fit it {fitted}."
    return Reading("value", name, what, done, calibrated=partial(_with_values, parameter, True))


def _with_values(parameters: tuple[Parameter, ...], by_recording: bool, calibration: Calibration) -> Calibration:
    """Return the calibration with some parameters searched, each for all recordings or by recording."""
    new = tuple(replace(p, per_recording=by_recording) for p in parameters)
    own = for_recordings(ParameterSet(new), calibration.model, calibration.data.recordings)
    return _searched(calibration, own.items, new)


def _searched(calibration: Calibration, new: Sequence[Parameter], replaced: Sequence[Parameter]) -> Calibration:
    """Return the calibration with new parameters in the place of some, fixed or free."""
    names = {p.name for p in replaced}
    kept = tuple(p for p in calibration.parameters if p.name not in names)
    fixed = {n: v for n, v in calibration.fixed.items() if n not in names}
    return replace(calibration, parameters=ParameterSet((*kept, *new)), fixed=fixed)


def _is_shared(p: Parameter) -> bool:
    return p.recording is None and isinstance(p.target, ParameterTarget)


def _held(calibration: Calibration) -> list[Parameter]:
    """Return held parameters whose values are within their bounds."""
    inside = (p for p in held_parameters(calibration) if p.lower <= p.start <= p.upper)
    return list(islice(inside, MOST_HELD))
