"""Runs of a fitted model on other inputs, and what inputs do between samples.

A recording that was not fitted takes delay and initial state from those that were."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from aero_bayes.arrays import FloatArray
from aero_bayes.data.initial_level import InitialLevel, initial_level
from aero_bayes.data.noise import output_noise_floor
from aero_bayes.data.recording import Recording, to_experiment
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate import swarm as pso
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.global_search import GlobalSearch, GlobalSearchResult
from aero_bayes.estimate.initial_states import first_reading_of, in_units_of, starts_as_fixed, state_of
from aero_bayes.estimate.local_fit import GOOD_FIT_RATIO, OpenSimulator, Optimum, floor_ratio
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    Filtered,
    Interpolation,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    StartTarget,
    Trajectories,
)
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator

#: Least share of an input's changes that follow another change at once, for linear interpolation to make sense.
MIN_FOLLOWING_SHARE = 0.5
#: Gain in log-likelihood at which another interpolation of an input is preferred.
MIN_LOG_LIKELIHOOD_GAIN = 10.0


def moving_inputs(recording: Recording, model: Model) -> tuple[str, ...]:
    """List inputs that may be linear between the samples of a recording: most changes follow another at once."""
    discrete = {variable.name for variable in model.inputs if variable.discrete}
    moving = []
    for name, values in recording.inputs.items():
        changed = np.diff(values) != 0.0
        if name not in discrete and (changed[1:] & changed[:-1]).sum() > MIN_FOLLOWING_SHARE * changed.sum():
            moving.append(name)
    return tuple(moving)


def _moving_anywhere(calibration: Calibration) -> list[str]:
    names = (name for r in calibration.data.recordings for name in moving_inputs(r, calibration.model))
    return list(dict.fromkeys(names))


def with_interpolation(
    calibration: Calibration, interpolation: Mapping[str, Interpolation], only: Collection[int] | None = None
) -> Calibration:
    """Return the calibration with another interpolation of some of its inputs, in some of its recordings.

    Each recording is looked at by itself: what was commanded in steps in one of them holds there."""
    at_rest = calibration.model.declared.recording.zero_at_rest
    data = calibration.data
    experiments = list(data.experiments)
    for k, recording in enumerate(data.recordings):
        if only is None or k in only:
            now = {signal.name: signal.interpolation for signal in experiments[k].inputs}
            moving = moving_inputs(recording, calibration.model)
            wanted = now | {n: how if n in moving else "hold" for n, how in interpolation.items()}
            again = to_experiment(recording, (), zero_at_rest=at_rest, interpolation=wanted)
            experiments[k] = replace(experiments[k], inputs=again.inputs)
    return replace(calibration, data=data.with_experiments(experiments))


def interpolation_for(recording: Recording, data: MeasuredData, model: Model) -> dict[str, Interpolation]:
    """Return what the inputs of a recording that was not fitted do between its samples.

    An input that is linear in the fitted data holds where it jumps now and then, unless it was linear there, too."""
    moving = set(moving_inputs(recording, model))
    for experiment, fitted in zip(data.experiments, data.recordings, strict=True):
        linear = {signal.name for signal in experiment.inputs if signal.interpolation == "linear"}
        moving |= linear - set(moving_inputs(fitted, model))
    return {name: how if name in moving else "hold" for name, how in data.interpolation.items()}


def first_moves_in(calibration: Calibration, fitted: int) -> tuple[list[str], list[int]]:
    """Return inputs that move in recordings that were not fitted only, of which no fit tells; and these recordings."""
    moving = [set(moving_inputs(r, calibration.model)) for r in calibration.data.recordings]
    known = set[str]().union(*moving[:fitted])
    where = [k for k, names in enumerate(moving) if k >= fitted and names - known]
    return sorted(set[str]().union(*moving[fitted:]) - known), where


def choose_interpolation(
    search: GlobalSearch, result: GlobalSearchResult, open_simulator: OpenSimulator, rng: np.random.Generator
) -> tuple[Calibration, Optimum] | None:
    """Choose the likelier interpolation of each input, hold or linear; None if no input changes.

    With inputs that hold, a fit can have a wrong optimum, such as a resonance above the Nyquist frequency that appears
    at the samples as an alias below it."""
    before, here = search.objective.calibration, result.optimum
    moving = _moving_anywhere(before)
    if not moving:
        return None
    linear = with_interpolation(before, dict.fromkeys(moving, "linear"))
    # It may be at a wrong optimum: the other interpolation then starts anew.
    far = floor_ratio(search.objective, here.evaluation.residual) > GOOD_FIT_RATIO
    found = _better_fit(search, here, linear, open_simulator, (rng, result.swarm) if far else None)
    best, here = (before, here) if found is None else (linear, found)
    for name in moving if len(moving) > 1 else ():
        other = with_interpolation(best, {name: "hold" if best.data.interpolation[name] == "linear" else "linear"})
        found = _better_fit(search, here, other, open_simulator)
        best, here = (best, here) if found is None else (other, found)
    return None if best is before else (best, here)


def _better_fit(
    search: GlobalSearch, here: Optimum, other: Calibration, open_simulator: OpenSimulator,
    anew: tuple[np.random.Generator, pso.SwarmResult | None] | None = None,
) -> Optimum | None:  # fmt: skip
    """Return the best fit of another calibration if it is likelier.

    From a known optimum, and from the start if ``anew``."""
    enough = here.log_likelihood + MIN_LOG_LIKELIHOOD_GAIN
    with open_simulator(other.problem()) as simulator:
        study = search.objective.with_calibration(other, simulator)
        if anew is not None:
            with suppress(CannotFinishError):
                found = GlobalSearch(study, search.settings).run(here.free, open_simulator, *anew).optimum
                if found.log_likelihood > enough:
                    return found
        found = GlobalSearch(study, search.settings).refit(here.coordinates, here.free, here.noise)
    return found if found.log_likelihood > enough else None


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


def simulate(
    calibration: Calibration,
    values: FloatArray,
    inputs: Recording | Mapping[str, ArrayLike],
    *,
    parameters: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    engine: str = "native",
) -> Recording:
    """Simulate a model with fitted values (p,) on inputs; :meth:`aero_bayes.Fit.simulate` says how."""
    recording = as_recording(inputs, calibration)
    found = run_problem(calibration, recording, values[np.newaxis], parameters=parameters, start=start, engine=engine)
    outcome = Outcome(int(found.outcomes[0, 0]))
    if outcome is not Outcome.OK:
        raise CannotFinishError(f"{calibration.model.name} could not be simulated: {outcome.text}")
    variables = {v.name: v.unit for v in (*calibration.model.inputs, *calibration.model.outputs)}
    outputs = {name: found.outputs[0][0, :, k].copy() for k, name in enumerate(calibration.data.outputs)}
    return Recording(f"{recording.name} (simulated)", recording.time, recording.inputs, outputs, variables)


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


def run_problem(
    calibration: Calibration,
    recording: Recording,
    values: FloatArray,
    *,
    parameters: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    workers: int | None = 0,
    engine: str = "native",
) -> Trajectories:
    """Simulate a calibration's model over a recording's times for many parameter vectors."""
    problem, matrix = _problem(calibration, recording, values, parameters or {}, start or {})
    with open_simulator(problem, "fmpy" if engine == "fmpy" else "native", workers) as simulator:
        return simulator.simulate(matrix)


def run_filter(
    calibration: Calibration, recording: Recording, values: FloatArray, *, workers: int | None = 0,
    engine: str = "native",
) -> Filtered:  # fmt: skip
    """Return what a calibration with process noise predicts of a recording, whose readings it is not told.

    The parameters are those of :func:`run_problem`."""
    problem, matrix = _problem(calibration, recording, values, {}, {})
    with open_simulator(problem, "fmpy" if engine == "fmpy" else "native", workers) as simulator:
        return cast(NativeSimulator, simulator).filter(matrix)


def _problem(
    calibration: Calibration, recording: Recording, values: FloatArray, parameters: Mapping[str, float],
    start: Mapping[str, float],
) -> tuple[Problem, FloatArray]:  # fmt: skip
    """Return a calibration's problem over a recording's times, and the values of its columns."""
    own = next((k for k, r in enumerate(calibration.data.recordings) if r.sha256 == recording.sha256), None)
    between = interpolation_for(recording, calibration.data, calibration.model)
    known = {name: value for name, value in recording.known.items() if name not in parameters}
    like = calibration.data.experiments[own or 0]
    experiment = replace(
        to_experiment(recording, [], interpolation=between), outputs=calibration.data.outputs, measured=None,
        spread=None, known=known, start_sd=like.start_sd,
        start=like.start if own is not None else _first_readings(recording, calibration),
    )  # fmt: skip
    columns = _columns(calibration, recording, values, own)
    fixed = dict(calibration.fixed)
    for name, value in parameters.items():
        calibration.model.parameter(name)
        if not math.isfinite(value):
            raise InputError(f"parameter {name} is {value}, which is no finite number")
        columns.pop(ParameterTarget(name), None)
        fixed[name] = float(value)
    for name, value in start.items():
        state = calibration.model.states[calibration.model.state_index(name)].name
        columns.pop(StartTarget(state), None)
        experiment = replace(experiment, start={**experiment.start, state: float(value)})
    alone = replace(calibration, data=MeasuredData((experiment,), (recording.name,), (recording,)))
    problem = replace(alone.problem(), targets=(tuple(columns),), fixed=fixed)
    matrix = np.column_stack(list(columns.values())) if columns else np.empty((len(values), 0))
    return problem, matrix


def _first_readings(recording: Recording, calibration: Calibration) -> dict[str, float]:
    """Read the start of states of a new recording, where they started at a reading in those that were fitted.

    So start those that the model fixes elsewhere than this recording begins."""
    model = calibration.model
    begun = {state for experiment in calibration.data.experiments for state in experiment.start}
    anywhere = set(calibration.data.outputs) if model.declared.recording.resting is None else set()
    for output in anywhere & recording.outputs.keys():
        state, reading = state_of(model, output), first_reading_of(recording.outputs[output], recording)
        if state is not None and reading is not None and state.name in model.fixed_starts:
            begun |= set() if starts_as_fixed(model, state, recording, output, reading) else {state.name}
    readings = {state: first_reading(recording, StartTarget(state), calibration) for state in sorted(begun)}
    return {state: first.level for state, first in readings.items() if first is not None}


def _columns(
    calibration: Calibration, recording: Recording, values: FloatArray, own: int | None
) -> dict[ProblemTarget, FloatArray]:
    """Return what each column of the simulated problem means, and its values (n,)."""
    columns: dict[ProblemTarget, FloatArray] = {
        p.target: values[:, j] for j, p in enumerate(calibration.parameters) if p.acts_in(own)
    }
    if own is None:
        for target, mean in typical(calibration, values, calibration.data.recordings).items():
            first = first_reading(recording, target, calibration)
            if isinstance(target, StartTarget) and first is None and recording.outputs == {}:
                continue
            columns[target] = mean + (first.level if first else 0.0)
    return columns
