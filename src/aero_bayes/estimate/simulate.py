"""A fitted model over whole recordings: the one rule for those that were not fitted.

They are read as they would be for a fit. What each recording has alone follows the fitted ones: a delay is their mean,
an initial value is its own first reading, off it by as much as theirs were. Where a fit estimates the initial state,
that of another recording is estimated, too: from its beginning, with all else held."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from aero_bayes.arrays import FloatArray
from aero_bayes.data.initial_level import InitialLevel, initial_level
from aero_bayes.data.noise_floor import output_noise_floor
from aero_bayes.data.recording import Recording
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration, assemble, for_recordings, templates
from aero_bayes.estimate.initial_states import in_units_of, state_of, with_free_starts
from aero_bayes.estimate.interpolation import first_moves_in, interpolation_for, with_interpolation
from aero_bayes.estimate.local_fit import LocalFitSettings, OpenSimulator, local_fit
from aero_bayes.estimate.noise import NoiseModel, OutputNoise
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    DelayTarget,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    Simulator,
    StartTarget,
)
from aero_bayes.simulation.model import Model

#: Share of the information on its initial states that the beginning of a recording holds, from which they are
#: estimated, and the most of its readings that this may be.
START_INFORMATION, MOST_FOR_STARTS = 0.95, 0.5
#: Samples of a recording that is not looked at, and fewest that tell its initial states.
FEWEST_ROWS = 20


class ModelFamily(Protocol):
    """A model, and the same model with laws added."""

    def base_model(self) -> Model:
        """Return the model without any law."""

    def transfer(self, calibration: Calibration, model: Model) -> Calibration:
        """Return a calibration of the base model with an extended one in its place."""


@dataclass(frozen=True)
class Place:
    """A recording's place among those that were fitted, or how many samples of a new one tell how it starts.

    Where that number is not given, the beginning does."""

    fitted: int | None = None
    confirming: int | None = None


def on_recordings(
    calibration: Calibration, values: FloatArray, recordings: Sequence[Recording], noise: Mapping[str, OutputNoise],
    open_simulator: OpenSimulator, *, every: bool = False, places: Sequence[Place] | None = None,
    family: ModelFamily | None = None,
) -> tuple[Calibration, FloatArray]:  # fmt: skip
    """Return a calibration on whole recordings, and its values there (n, q) for SI values (n, p), the fit's first.

    One that was fitted, by its place or as its hash tells, keeps its own values. Of another one not only the initial
    state is estimated but ``every`` value that it has alone, where the question is how well it is predicted by what all
    have in common. The model may be an extended one of a ``family``."""
    if places is None:
        known = [r.sha256 for r in calibration.data.recordings]
        places = [Place(known.index(r.sha256) if r.sha256 in known else None) for r in recordings]
    fitted = [place.fitted for place in places]
    new = [k for k, index in enumerate(fitted) if index is None]
    added, hidden = set[str](), False
    if family is None:
        whole = _read_whole(calibration, recordings, calibration.parameters, calibration.model)
        rows = _values_there(calibration, values, whole, fitted)
    else:
        base, added = _read_by_family(calibration, recordings, family)
        whole = replace(family.transfer(base, calibration.model), fixed=calibration.fixed)
        rows = _values_there(_renamed(calibration, base, whole), values, base, fitted)
        # A law at an output hides the initial value of its state.
        hidden = [p.target for p in base.parameters] != [p.target for p in whole.parameters]
    whole = _as_inputs_move(whole, calibration, rows[0], new, open_simulator)
    if every:
        estimated = [j for j, p in enumerate(whole.parameters) if p.recording in new]
    else:
        hidden = hidden or (whole.settings.initial_states == "estimated" and whole.process is None)
        # A recording without readings starts where the model does.
        read = {k for k in new if np.isfinite(whole.data.measured[k]).any()}
        estimated = [
            j for j, p in enumerate(whole.parameters)
            if p.recording in read and (p.name in added or (hidden and (isinstance(p.target, StartTarget) or p.starts)))
        ]  # fmt: skip
    if not estimated:
        return whole, rows
    short = [k for k in new if places[k].confirming is None]
    ends = [
        r.rows if place.confirming is None else place.confirming for r, place in zip(recordings, places, strict=True)
    ]
    lengths = [end if k in new else FEWEST_ROWS for k, end in enumerate(ends)]
    found = _with_estimated_starts(whole, rows[0], estimated, lengths, short, noise, open_simulator)
    return whole, np.vstack([found, rows[1:] + (found - rows[0])])


def _read_by_family(
    calibration: Calibration, recordings: Sequence[Recording], family: ModelFamily
) -> tuple[Calibration, set[str]]:
    """Return the calibration of the base model on whole recordings, and the names of initial values that it lacks.

    Only the base model shows which states start at a reading: in an extended one a law may act on it."""
    plain, shared = family.base_model(), templates(calibration.parameters)
    known = {v.name for v in plain.parameters}
    new = [
        p for p in shared if (p.target.name not in known if isinstance(p.target, ParameterTarget) else bool(p.starts))
    ]
    base = _read_whole(calibration, recordings, ParameterSet(tuple(p for p in shared if p not in new)), plain)
    own = for_recordings(ParameterSet(tuple(new)), plain, base.data.recordings)
    return replace(base, parameters=base.parameters.extended(own.items)), {p.name for p in own}


def _renamed(calibration: Calibration, base_named: Calibration, whole: Calibration) -> Calibration:
    """Return the calibration of an extended model with its states named as in the base model."""
    old = {there.target: here.target for here, there in zip(base_named.parameters, whole.parameters, strict=True)}
    items = tuple(replace(p, target=old.get(p.target, p.target)) for p in calibration.parameters)
    return replace(calibration, model=base_named.model, parameters=ParameterSet(items))


def _read_whole(
    calibration: Calibration, recordings: Sequence[Recording], parameters: ParameterSet, model: Model
) -> Calibration:
    """Return what was fitted on whole recordings, each with its own delay and initial values, and all its readings."""
    delay = next((p for p in calibration.parameters if p.target == DelayTarget() and p.recording is not None), None)
    settings = replace(
        calibration.settings, outputs=calibration.data.outputs, most_readings=None, keep_standstill_readings=True,
        interpolation=calibration.data.interpolation, solver=calibration.solver,
        delay="none" if delay is None else "free",
        max_input_delay=None if delay is None else delay.upper or delay.lower,
    )  # fmt: skip
    named = [replace(r, name=f"{r.name}#{k}") for k, r in enumerate(recordings)]
    known = {v.name for v in model.parameters}
    fixed = {name: value for name, value in calibration.fixed.items() if name in known}
    noise = replace(calibration.noise, sd={}) if calibration.process is not None else NoiseModel()
    shared = ParameterSet(tuple(templates(parameters)))
    found = assemble(named, model, shared, fixed, noise, settings)
    free = with_free_starts(found.parameters, found.data.experiments, model)
    return replace(found, settings=calibration.settings, parameters=free)


def _values_there(
    calibration: Calibration, values: FloatArray, whole: Calibration, fitted: Sequence[int | None]
) -> FloatArray:
    """SI values (n, q) of the parameters of ``whole`` where those of a calibration are ``values`` (n, p).

    ``fitted`` says which of the fitted recordings each one of ``whole`` is, if it is one."""
    parameters, recordings = calibration.parameters, whole.data.recordings
    shared = {p.name: values[:, j] for j, p in enumerate(parameters) if p.recording is None}
    own: dict[tuple[int | None, ProblemTarget], FloatArray] = {
        (k, p.target): values[:, j] for j, p in enumerate(parameters) if p.recording is not None
        for k in (p.recording, *p.shared_with)
    }  # fmt: skip
    follow = _typical(calibration, values)
    columns = []
    for p in whole.parameters:
        value = shared.get(p.name) if p.recording is None else own.get((fitted[p.recording], p.target))
        if value is None:
            value = np.full(len(values), p.start)
            if p.recording is not None:
                recording = recordings[p.recording]
                first = first_reading(recording, p.target, whole)
                # Without any reading a state starts where the model does.
                off = {} if isinstance(p.target, StartTarget) and not recording.outputs else follow
                value = off.get(p.target, value) if first is None else first.level + off.get(p.target, 0.0 * value)
            value = np.clip(value, p.lower, p.upper)
        columns.append(value)
    return np.column_stack(columns) if columns else np.empty((len(values), 0))


def _typical(calibration: Calibration, values: FloatArray) -> dict[ProblemTarget, FloatArray]:
    """Compute the mean over the fitted recordings of what belongs to each alone; of a start that is read, how far off
    the first reading it is."""
    found: dict[ProblemTarget, list[tuple[FloatArray, float]]] = {}
    for j, p in enumerate(calibration.parameters):
        if p.recording is not None:
            recording = calibration.data.recordings[p.recording]
            first = first_reading(recording, p.target, calibration) or InitialLevel(0.0, 0.0)
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
    started = (
        (target.state,)
        if isinstance(target, StartTarget)
        else next((p.starts for p in calibration.parameters if p.target == target), ())
    )
    if not started:
        return None
    states = {o: s.name for o in calibration.data.outputs if (s := state_of(calibration.model, o)) is not None}
    output = next((o for o, s in states.items() if s in started), None)
    if output is None or (values := recording.outputs.get(output)) is None:
        return None
    return initial_level(values, recording.time, output_noise_floor(recording, output).sd or 0.0)


def _as_inputs_move(
    whole: Calibration, calibration: Calibration, row: FloatArray, new: Collection[int], open_simulator: OpenSimulator
) -> Calibration:
    """Return a calibration on whole recordings with the inputs of each read as they move in it, if that is left to the
    data.

    Where an input moves in ``new`` recordings only, the reading that predicts the better is taken."""
    if calibration.settings.interpolation != "auto":
        return whole
    for k, recording in enumerate(whole.data.recordings):
        whole = with_interpolation(whole, interpolation_for(recording, calibration.data, calibration.model), {k})
    names, where = first_moves_in(calibration, {k: whole.data.recordings[k] for k in new})
    if not names:
        return whole
    linear = with_interpolation(whole, dict.fromkeys(names, "linear"), where)
    errors = []
    for one in (whole, linear):
        with open_simulator(one.problem()) as simulator:
            found = simulator.simulate(row[np.newaxis]).outputs
        left = [np.nanmean((y - f[0]) ** 2, axis=0) for y, f in zip(one.data.measured, found, strict=True)]
        errors.append([float(np.nansum(np.log(np.maximum(squares, 1e-300)))) for squares in left])
    better = {k for k in where if errors[1][k] < errors[0][k]}
    return with_interpolation(whole, dict.fromkeys(names, "linear"), better)


def _with_estimated_starts(
    whole: Calibration, row: FloatArray, starts: Sequence[int], rows: Sequence[int], short: Collection[int],
    noise: Mapping[str, OutputNoise], open_simulator: OpenSimulator,
) -> FloatArray:  # fmt: skip
    """Values (q,) with initial values, some columns, estimated from the first ``rows`` samples of each recording.

    Of ``short`` ones only from as many as hold most of the information on them."""
    at = whole.parameters.to_search(row)
    if short:
        rows = _informative_rows(beginnings(whole, rows), at, starts, rows, short, open_simulator)
    beginning = beginnings(whole, rows)
    with open_simulator(beginning.problem()) as simulator, suppress(CannotFinishError):
        objective = objective_of(beginning, simulator)
        end = local_fit(objective, at, starts, noise=noise, settings=LocalFitSettings(hold_noise=True))
        return whole.parameters.from_search(end.coordinates)
    return row


def _informative_rows(
    whole: Calibration, at: FloatArray, starts: Sequence[int], rows: Sequence[int], short: Collection[int],
    open_simulator: OpenSimulator,
) -> list[int]:  # fmt: skip
    """Samples of each recording, of the ``short`` ones those that hold most of the information on initial values."""
    with open_simulator(whole.problem()) as simulator:
        objective = objective_of(whole, simulator)
        found, kept = objective.evaluate(at, starts), list(rows)
    for k in short:
        least = FEWEST_ROWS
        for series, slopes in zip(objective.series, (found.slopes or ()) if found else (), strict=False):
            if series.experiment == k:
                seen = np.cumsum(slopes**2, axis=1)
                enough = np.argmax(seen >= START_INFORMATION * seen[:, -1:], axis=1)
                least = max(least, int(series.sampling.index[enough.max(initial=0)]) + 1)
        kept[k] = min(least, max(int(MOST_FOR_STARTS * rows[k]), FEWEST_ROWS))
    return kept


def beginnings(whole: Calibration, rows: Sequence[int]) -> Calibration:
    """The calibration on the first ``rows`` samples of each recording."""
    experiments = (e.at_samples(slice(n)) for e, n in zip(whole.data.experiments, rows, strict=True))
    return replace(whole, data=whole.data.with_experiments(experiments))


def opener(workers: int | None = 0) -> Callable[[Problem], Simulator]:
    """Return what opens simulators with so many workers."""
    return lambda problem: open_simulator(problem, workers)


def simulate(
    calibration: Calibration, values: FloatArray, inputs: Recording | Mapping[str, ArrayLike],
    noise: Mapping[str, OutputNoise], *, parameters: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
) -> Recording:  # fmt: skip
    """Simulate a model with fitted values (p,) on inputs; :meth:`aero_bayes.Fit.simulate` says how."""
    recording, model = as_recording(inputs, calibration), calibration.model
    whole, rows = on_recordings(calibration, values[np.newaxis], [recording], noise, opener())
    columns: dict[ProblemTarget, FloatArray] = {p.target: rows[:, j] for j, p in enumerate(whole.parameters)}
    (experiment,), fixed = whole.data.experiments, dict(whole.fixed)
    for name, value in (parameters or {}).items():
        model.parameter(name)
        if not math.isfinite(value):
            raise InputError(f"parameter {name} is {value}, which is no finite number")
        columns.pop(ParameterTarget(name), None)
        fixed[name] = float(value)
    for name, value in (start or {}).items():
        state = model.states[model.state_index(name)].name
        columns.pop(StartTarget(state), None)
        experiment = replace(experiment, start={**experiment.start, state: float(value)})
    kept = {name: value for name, value in experiment.known.items() if name not in (parameters or {})}
    experiment = replace(experiment, known=kept)
    problem = replace(whole.problem(), experiments=(experiment,), targets=(tuple(columns),), fixed=fixed)
    with open_simulator(problem, 0) as simulator:
        found = simulator.simulate(np.column_stack(list(columns.values())) if columns else np.empty((1, 0)))
    outcome = Outcome(int(found.outcomes[0, 0]))
    if outcome is not Outcome.OK:
        raise CannotFinishError(f"{model.name} could not be simulated: {outcome.text}")
    units = {v.name: v.unit for v in (*model.inputs, *model.outputs)}
    outputs = {name: found.outputs[0][0, :, k].copy() for k, name in enumerate(calibration.data.outputs)}
    return Recording(f"{recording.name} (simulated)", recording.time, recording.inputs, outputs, units)


def as_recording(inputs: Recording | Mapping[str, ArrayLike], calibration: Calibration) -> Recording:
    """Take inputs by name as a recording of nothing; InputError for what the model does not take."""
    if not isinstance(inputs, Recording):
        columns = {name: np.asarray(values, dtype=np.float64) for name, values in inputs.items()}
        if "time" not in columns:
            raise InputError("inputs given by name need their times in s under 'time'")
        time = columns.pop("time")
        signals = {name: np.broadcast_to(values, time.shape).copy() for name, values in columns.items()}
        inputs = Recording("inputs", time, signals, {})
    inputs = in_units_of(calibration.model, inputs)
    if inputs.rows < 2 or not np.all(np.diff(inputs.time) > 0.0):
        raise InputError(f"{inputs.name}: times must be at least two and increase")
    known = [v.name for v in calibration.model.inputs]
    driven = {signal.name for experiment in calibration.data.experiments for signal in experiment.inputs}
    for name, values in inputs.inputs.items():
        if name not in known:
            raise InputError(f"model {calibration.model.name} has no input {name}; it has {', '.join(known) or 'none'}")
        if not np.isfinite(values).all():
            raise InputError(f"{inputs.name}: input {name} is not finite everywhere")
    if missing := sorted(driven - set(inputs.inputs)):
        raise InputError(f"{inputs.name}: input {missing[0]} is missing, which the fit was driven by")
    return inputs
