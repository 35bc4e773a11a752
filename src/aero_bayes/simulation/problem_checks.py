"""Checks of a problem, and of what a simulator of it is given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import (
    DelayTarget,
    DiffusionTarget,
    Experiment,
    InputTarget,
    ParameterTarget,
    Problem,
    ProblemTarget,
    ProcessNoise,
    ReadingNoiseTarget,
    StartTarget,
)
from aero_bayes.simulation.model_description import ModelDescription, Variable


def check_problem(problem: Problem) -> None:
    """Raise InputError where the problem contradicts its model or itself."""
    if len(problem.targets) != len(problem.experiments) or not problem.experiments:
        raise InputError(f"{len(problem.experiments)} experiments but {len(problem.targets)} rows of targets")
    if len({len(row) for row in problem.targets}) > 1:
        raise InputError("every experiment needs the same number of targets (None where a column means nothing)")
    settings = problem.settings
    if not (settings.relative_tolerance > 0 and settings.absolute_tolerance > 0 and settings.time_limit > 0):
        raise InputError("tolerances and the time limit must be positive")
    for name in problem.fixed:
        problem.model.parameter(name)
    if problem.process is not None:
        check_process(problem.model, problem.process)
    for number, (experiment, row) in enumerate(zip(problem.experiments, problem.targets, strict=True)):
        _check_experiment(problem.model, experiment, f"experiment {number}")
        for target in row:
            _check_target(problem.model, experiment, target, f"experiment {number}")


def check_process(model: ModelDescription, process: ProcessNoise) -> None:
    """Raise InputError for process noise at what is no state of the model."""
    for name in process.diffusion:
        model.state_index(name)
    for name in process.reading_sd:
        model.output(name)
    for name, value in (*process.diffusion.items(), *process.reading_sd.items()):
        if not 0.0 <= value < float("inf"):
            raise InputError(f"process noise of {name}: {value:g} is not a standard deviation")


def _check_grid(where: str, time: FloatArray) -> None:
    if time.ndim != 1 or time.size == 0 or not np.all(np.isfinite(time)) or not np.all(np.diff(time) > 0):
        raise InputError(f"{where}: times must be finite and increasing")


def _check_experiment(model: ModelDescription, experiment: Experiment, where: str) -> None:
    _check_grid(where, experiment.time)
    for name in experiment.outputs:
        model.output(name)
    for name in (*experiment.start, *experiment.start_sd):
        model.state_index(name)
    for name in experiment.known:
        model.parameter(name)
    for signal in experiment.inputs:
        discrete = model.input(signal.name).discrete
        _check_grid(f"{where}, input {signal.name!r}", signal.time)
        if signal.values.shape != signal.time.shape or not np.all(np.isfinite(signal.values)):
            raise InputError(f"{where}, input {signal.name!r}: values must be finite, one a time")
        if signal.interpolation not in ("hold", "linear"):
            raise InputError(f"{where}, input {signal.name!r}: interpolation {signal.interpolation!r} is not known")
        if discrete and signal.interpolation == "linear":
            raise InputError(
                f"{where}, input {signal.name!r}: is discrete in the model, so it can hold, not move linearly"
            )
    measured = experiment.measured
    if measured is not None and measured.shape != (experiment.time.size, len(experiment.outputs)):
        raise InputError(
            f"{where}: measured has shape {measured.shape}, "
            f"expected ({experiment.time.size}, {len(experiment.outputs)})"
        )


def signal_index(experiment: Experiment, name: str) -> int:
    """Position of an input signal in the experiment."""
    for index, signal in enumerate(experiment.inputs):
        if signal.name == name:
            return index
    raise InputError(f"no signal for input {name!r} in the experiment")


def _check_target(model: ModelDescription, experiment: Experiment, target: ProblemTarget | None, where: str) -> None:
    if isinstance(target, ParameterTarget):
        model.parameter(target.name)
    elif isinstance(target, StartTarget):
        model.state_index(target.state)
    elif isinstance(target, DelayTarget):
        if target.input is not None:
            signal_index(experiment, target.input)
    elif isinstance(target, InputTarget):
        signal = experiment.inputs[signal_index(experiment, target.input)]
        if not 0 <= target.index < signal.time.size:
            raise InputError(f"{where}: input {target.input!r} has no grid point {target.index}")
    elif isinstance(target, DiffusionTarget):
        model.state_index(target.state)
    elif isinstance(target, ReadingNoiseTarget) and target.output not in experiment.outputs:
        raise InputError(f"{where}: has no output {target.output!r}")


def target_scale(model: ModelDescription, experiment: Experiment, target: ProblemTarget | None) -> float:
    """Return a natural size of a column, for finite differences at zero."""
    variable: Variable | None = None
    if isinstance(target, ParameterTarget):
        variable = model.parameter(target.name)
    elif isinstance(target, StartTarget):
        variable = model.states[model.state_index(target.state)]
    elif isinstance(target, InputTarget):
        variable = model.input(target.input)
        size = float(np.max(np.abs(experiment.inputs[signal_index(experiment, target.input)].values)))
        if size > 0:
            return size
    if variable is not None:
        for value in (variable.nominal, variable.start):
            if value:
                return abs(value)
    return 1.0


def check_values(problem: Problem, values: FloatArray) -> FloatArray:
    """Parameter vectors as a contiguous (n, p) array; InputError for another shape."""
    values = np.ascontiguousarray(values, dtype=np.float64)
    p = len(problem.targets[0])
    if values.ndim != 2 or values.shape[1] != p:
        raise InputError(f"parameter values have shape {values.shape}, expected (n, {p})")
    return values


def check_active(problem: Problem, active: Sequence[int]) -> NDArray[np.int64]:
    """Active columns as integers within range."""
    p = len(problem.targets[0])
    columns = np.asarray(active, dtype=np.int64).ravel()
    if columns.size and (columns.min() < 0 or columns.max() >= p):
        raise InputError(f"active columns {columns.tolist()} are not all within 0..{p - 1}")
    return columns


def check_noise(problem: Problem, noise: FloatArray, n: int) -> FloatArray:
    """Broadcast noise to each parameter vector, experiment and output."""
    if any(experiment.measured is None for experiment in problem.experiments):
        raise InputError("a likelihood needs measurements in every experiment")
    noise = np.asarray(noise, dtype=np.float64)
    shape = (n, len(problem.experiments), max(len(e.outputs) for e in problem.experiments), 3)
    try:
        return np.broadcast_to(noise, shape)
    except ValueError as error:
        raise InputError(f"noise has shape {noise.shape}, which does not broadcast to {shape}") from error
