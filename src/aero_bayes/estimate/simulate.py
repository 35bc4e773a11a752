"""Simulate a fitted model on other inputs, with other parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording, to_experiment
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.interpolation import first_reading, interpolation_for, typical
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    Filtered,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    StartTarget,
    Trajectories,
)
from aero_bayes.simulation.native_simulator import NativeSimulator


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
    own = _index(recording, calibration.data)
    between = interpolation_for(recording, calibration.data, calibration.model)
    experiment = to_experiment(recording, [], interpolation=between)
    known = {name: value for name, value in recording.known.items() if name not in parameters}
    experiment = replace(experiment, outputs=calibration.data.outputs, measured=None, spread=None, known=known)
    like = calibration.data.experiments[0 if own is None else own]
    experiment = replace(experiment, start_sd=like.start_sd)
    if own is not None:
        experiment = replace(experiment, start=like.start)
    else:
        experiment = replace(experiment, start=_first_readings(recording, calibration))
    columns = _columns(calibration, recording, values, own)
    fixed = dict(calibration.simulated.fixed)
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


def _index(recording: Recording, data: MeasuredData) -> int | None:
    """Find which of the fitted recordings this is, if any."""
    same = (k for k, fitted in enumerate(data.recordings) if fitted.sha256 == recording.sha256)
    return next(same, None)


def _first_readings(recording: Recording, calibration: Calibration) -> dict[str, float]:
    """Read the start of states of a new recording, where they started at a reading in those that were fitted."""
    begun = {state for experiment in calibration.data.experiments for state in experiment.start}
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
