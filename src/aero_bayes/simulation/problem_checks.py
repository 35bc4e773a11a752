"""Checks of a problem, and what simulators in Python share: parameters and inputs of a run, differences of runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import (
    ClosedAtExit,
    DelayTarget,
    DiffusionTarget,
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    ProcessNoise,
    ReadingNoiseTarget,
    StartTarget,
    Trajectories,
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
            target_code(problem.model, experiment, target)


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


def target_code(model: ModelDescription, experiment: Experiment, target: ProblemTarget | None) -> tuple[int, int]:
    """Return the number of ``TARGET_...`` in native/engine.h and what is set; InputError where there is none."""
    names = tuple(signal.name for signal in experiment.inputs)
    if isinstance(target, ParameterTarget):
        return 1, model.parameter(target.name).value_reference
    if isinstance(target, StartTarget):
        return 2, model.state_index(target.state)
    if isinstance(target, DelayTarget):
        if target.input is not None and target.input not in names:
            raise InputError(f"no signal for input {target.input!r} in the experiment")
        return 3, -1 if target.input is None else names.index(target.input)
    if isinstance(target, DiffusionTarget):
        return 4, model.state_index(target.state)
    if isinstance(target, ReadingNoiseTarget):
        if target.output not in experiment.outputs:
            raise InputError(f"no output {target.output!r} in the experiment")
        return 5, experiment.outputs.index(target.output)
    return 0, 0


def target_scale(model: ModelDescription, target: ProblemTarget | None) -> float:
    """Return a natural size of a column, for finite differences at zero."""
    variable: Variable | None = None
    if isinstance(target, ParameterTarget):
        variable = model.parameter(target.name)
    elif isinstance(target, StartTarget):
        variable = model.states[model.state_index(target.state)]
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


def signals_of_run(
    experiment: Experiment, row: Sequence[ProblemTarget | None], values: FloatArray
) -> tuple[InputSignal, ...]:
    """Apply one parameter vector's delays to the input signals of an experiment."""
    signals = []
    for signal in experiment.inputs:
        delaying = (isinstance(t, DelayTarget) and t.input in (None, signal.name) for t in row)
        delay = sum(float(value) for value, delays in zip(values, delaying, strict=True) if delays)
        signals.append(replace(signal, time=signal.time + delay))
    return tuple(signals)


def parameters_of_run(problem: Problem, number: int, values: FloatArray) -> dict[str, float]:
    """Return the parameters of one run that do not keep the model's own value."""
    row = zip(problem.targets[number], values, strict=True)
    fitted = {target.name: float(value) for target, value in row if isinstance(target, ParameterTarget)}
    return {**problem.fixed, **problem.experiments[number].known, **fitted}


def signal_values(signal: InputSignal, time: ArrayLike) -> FloatArray:
    """Compute an input at times of any shape."""
    at = np.asarray(time, dtype=float)
    if signal.interpolation == "linear":
        return np.asarray(np.interp(at, signal.time, signal.values))
    cell = np.searchsorted(signal.time, at + 1e-12 * np.maximum(1.0, np.abs(at)), side="right") - 1
    return np.asarray(signal.values[np.maximum(cell, 0)])


def linear_signals(signals: tuple[InputSignal, ...]) -> tuple[InputSignal, ...]:
    """Return those that are interpolated linearly."""
    return tuple(signal for signal in signals if signal.interpolation == "linear")


#: What a step in a delay is relative to, in s.
DELAY_SIZE = 0.1


class DifferencedRuns(ClosedAtExit):
    """A :class:`Simulator` whose slopes are central differences of whole runs."""

    problem: Problem
    #: Step of a difference relative to the value, and that of a delay in s where it is not relative.
    relative_step, delay_step = 1e-4, 1e-4 * DELAY_SIZE

    def outputs(self, values: FloatArray) -> Trajectories:
        """Simulate checked values; failed runs hold NaN."""
        raise NotImplementedError

    def simulate(self, values: FloatArray, *, active: Sequence[int] | None = None) -> Trajectories:
        """Trajectories; with ``active`` also differences for those columns. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        columns = check_active(self.problem, active if active is not None else [])
        found = self.outputs(values)
        if active is None:
            return found
        slopes = tuple(np.zeros((*out.shape, len(columns))) for out in found.outputs)
        outcomes = found.outcomes.copy()
        for place, column in enumerate(columns.tolist()):
            targets = [row[column] for row in self.problem.targets]
            scale = max(target_scale(self.problem.model, target) for target in targets)
            step = self.relative_step * np.where(values[:, column] != 0.0, np.abs(values[:, column]), scale)
            if self.delay_step and any(isinstance(target, DelayTarget) for target in targets):
                step[:] = self.delay_step
            sides = np.repeat(values, 2, axis=0)
            sides[0::2, column] += step
            sides[1::2, column] -= step
            ran = self.outputs(sides)
            outcomes = np.where(outcomes == Outcome.OK, np.maximum(ran.outcomes[0::2], ran.outcomes[1::2]), outcomes)
            for e, out in enumerate(ran.outputs):
                if targets[e] is not None:
                    slopes[e][..., place] = (out[0::2] - out[1::2]) / (2.0 * step)[:, None, None]
        for e, out in enumerate(found.outputs):
            out[outcomes[:, e] != Outcome.OK] = np.nan
        return Trajectories(found.outputs, slopes, outcomes)


class SingleRuns(DifferencedRuns):
    """One that does one run after the other, in this process."""

    def run_once(self, number: int, values: FloatArray) -> tuple[FloatArray, Outcome]:
        """Simulate one experiment at one parameter vector (p,): outputs (n, m), NaN where the run fails."""
        raise NotImplementedError

    def outputs(self, values: FloatArray) -> Trajectories:
        """Simulate checked values."""
        experiments = self.problem.experiments
        outcomes = np.zeros((len(values), len(experiments)), dtype=np.uint8)
        outputs = tuple(np.empty((len(values), e.time.size, len(e.outputs))) for e in experiments)
        for i, e in np.ndindex(outcomes.shape):
            outputs[e][i], outcomes[i, e] = self.run_once(e, values[i])
        return Trajectories(outputs, None, outcomes)

    def close(self) -> None:
        """Free what the simulator holds."""
