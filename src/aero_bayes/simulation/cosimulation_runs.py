"""Runs of a co-simulation FMU by FMPy, inside a worker process."""

from __future__ import annotations

import contextlib
import ctypes
import os
import pickle
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from numpy.typing import ArrayLike

from aero_bayes.arrays import FloatArray
from aero_bayes.simulation import fmpy_fmu
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
)
from aero_bayes.simulation.model_description import ModelDescription
from aero_bayes.simulation.worker_group import LoadError
from aero_bayes.simulation.worker_main import JOB_WORDS, NOT_LOADED, SPENT


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


def value_at(signal: InputSignal, t: float, segment: float) -> float:
    """Value at t within the segment that starts at `segment` (which decides on the side of a jump)."""
    return float(signal_values(signal, t if signal.interpolation == "linear" else segment))


def linear_signals(signals: tuple[InputSignal, ...]) -> tuple[InputSignal, ...]:
    """Return those that are interpolated linearly."""
    return tuple(signal for signal in signals if signal.interpolation == "linear")


LAST_STEP = 1e-3  # of a sampling interval, where an input moves linearly
STEP_SHARE = 1e-6  # of a step: samples that are so near to its end are there
WORDS = "words"  # file in a worker's folder with what its FMU said last of trouble
_TOTAL, _EXPERIMENTS, _P, _VALUES, _OUTCOME, _TABLE = map(
    JOB_WORDS.index, ("total", "experiments", "p", "values", "outcomes", "table")
)


class Begin(Enum):
    """What puts an FMU back to its start before a run."""

    RESET = "fmi2Reset or fmi3Reset"
    NEW = "a new instance"
    NOTHING = "not even a new instance"


class _SpentError(Exception):
    """The FMU cannot be instantiated again in this process."""


class _NotRepeatableError(Exception):
    """Equal runs of the FMU differ."""


@dataclass
class _Instance:
    """The instance of an FMU in this process, which serves every problem on it."""

    model: ModelDescription
    folder: Path
    begin: Begin | None = None
    fmu: Any = None
    opened: bool = False
    values: bytes = b""
    words: str = ""

    def hear(self, words: str) -> None:
        """Keep what the FMU says of trouble."""
        self.words = words or self.words

    def ready(self, new: bool) -> Any:
        """FMPy's object for the FMU, reset or instantiated anew."""
        if self.fmu is not None and not new:
            with contextlib.suppress(FMICallException):
                self.fmu.reset()
                return self.fmu
        if self.fmu is not None:
            self.fmu.freeInstance()
            self.fmu = None
        try:
            self.fmu = fmpy_fmu.open_fmu(self.model, self.folder, self.hear)
        except LoadError:
            raise
        except Exception as error:  # FMPy's own errors have no common class
            raise _SpentError if self.opened else error from None
        self.opened = True
        return self.fmu


@dataclass
class CosimulationRuns:
    """A problem and the FMU that runs it."""

    problem: Problem
    instance: _Instance
    substeps: int
    load_error: str = ""
    _slot: Any = None

    def batch(self, engine: ctypes.CDLL, base: int, job: int, slot: int, first: int) -> int:
        """Take tasks from the job's counter until none is left; base, job and slot are addresses. Ends as the
        engine's own (native/batch.c).
        """
        words = (ctypes.c_int64 * len(JOB_WORDS)).from_address(job)
        mine = self._slot = (ctypes.c_int64 * 3).from_address(slot)
        outcomes = (ctypes.c_uint8 * words[_TOTAL]).from_address(base + words[_OUTCOME])
        index = first if first >= 0 else engine.ab_take(job)
        while index < words[_TOTAL]:
            if outcomes[index] == 255:
                self._stamp()
                mine[0] = index
                try:
                    outcomes[index] = self._do(words, base, index)
                except _SpentError:
                    return SPENT
                except LoadError as error:
                    self.load_error = str(error)
                    mine[0], mine[1] = -1, 0
                    return NOT_LOADED
                mine[0] = -1
            index = engine.ab_take(job)
        return 0

    def _stamp(self) -> None:
        self._slot[2], self._slot[1] = clock.process_time_ns(), clock.monotonic_ns()

    def _do(self, words: Any, base: int, index: int) -> int:
        row, number = divmod(index, words[_EXPERIMENTS])
        p = words[_P]
        values = np.ctypeslib.as_array((ctypes.c_double * p).from_address(base + words[_VALUES] + 8 * row * p))
        table = (ctypes.c_int64 * 4).from_address(base + words[_TABLE] + 32 * number)
        experiment = self.problem.experiments[number]
        shape = experiment.time.size, len(experiment.outputs)
        out = np.ctypeslib.as_array((ctypes.c_double * table[1]).from_address(base + table[0] + 8 * row * table[1]))
        if not np.all(np.isfinite(values)):
            return Outcome.NOT_FINITE
        try:
            found = self._checked(number, values)
        except (LoadError, _SpentError):
            raise
        except _NotRepeatableError:
            return Outcome.NOT_REPEATABLE
        except Exception as error:  # FMPy's own errors have no common class
            self.instance.fmu = None  # not freed: the error may have been fatal
            with contextlib.suppress(OSError):
                Path(WORDS).write_text(self.instance.words or str(error))
            return Outcome.MODEL_ERROR
        if not np.all(np.isfinite(found)):
            return Outcome.NOT_FINITE
        out.reshape(shape)[:] = found
        return Outcome.OK

    def _checked(self, number: int, values: FloatArray) -> FloatArray:
        """Return one run, begun by a reset only where that was seen to do as much as a new instance.

        Compared once, at the
        first run with other values than the one before it; where there can be no new instance, at the second run."""
        instance, once = self.instance, self.problem.model.needs_instance_per_process
        if instance.begin is None and instance.values and (once or instance.values != values.tobytes()):
            instance.begin, found = self._compare(number, values)
        elif instance.begin is not Begin.NOTHING:
            found = self._run(number, values, new=instance.begin is not Begin.RESET)
        if instance.begin is Begin.NOTHING:
            raise _NotRepeatableError
        instance.values = values.tobytes() or b"none"
        return found

    def _compare(self, number: int, values: FloatArray) -> tuple[Begin, FloatArray]:
        """Compare a run after a reset with the same one on a new instance, or after one more reset if there is none."""
        once = self.problem.model.needs_instance_per_process
        try:
            reset = self._run(number, values, new=False)
        except Exception:  # FMPy's own errors have no common class
            self.instance.fmu, reset = None, np.zeros(0)
        found = self._run(number, values, new=not once)
        if np.array_equal(reset, found, equal_nan=True):
            return Begin.RESET, found
        if once:
            raise _SpentError
        again = self._run(number, values, new=True)
        near = 1e-5 * np.ptp(found, axis=0) + 1e-9 * np.max(np.abs(found), axis=0)
        return Begin.NEW if np.all(np.abs(again - found) <= near) else Begin.NOTHING, again

    def _run(self, number: int, values: FloatArray, *, new: bool) -> FloatArray:
        problem, experiment = self.problem, self.problem.experiments[number]
        model, samples = problem.model, experiment.time
        signals = signals_of_run(experiment, problem.targets[number], values)
        self._stamp()
        fmu = self.instance.ready(new)
        fmu.setupExperiment(startTime=float(samples[0]))
        for name, value in parameters_of_run(problem, number, values).items():
            fmu.setReal([model.parameter(name).value_reference], [value])
        self._apply(fmu, signals, float(samples[0]), float(samples[0]))
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        variables = [model.output(name) for name in experiment.outputs]
        get = {"real": fmu.getReal, "integer": fmu.getInteger, "boolean": fmu.getBoolean}
        if model.takes_any_step:
            points, times = communication_points(samples, signals, self.substeps)
        else:
            points = equal_steps(samples, model.step_size or experiment.interval)
            times = 0.5 * (points[1:] + points[:-1])
        read = np.isin(points, samples) if model.takes_any_step else np.ones(points.size, dtype=bool)
        slopes = () if model.takes_any_step or not model.interpolates_inputs else linear_signals(signals)
        out = np.empty((points.size, len(variables)))
        for k, t in enumerate(points):
            if read[k]:
                out[k] = [float(get[v.kind]([v.value_reference])[0]) for v in variables]
            if k + 1 < points.size:
                begin, step = float(t), float(points[k + 1] - t)
                self._apply(fmu, signals, float(times[k]), begin)
                for signal in slopes:
                    reference = [model.input(signal.name).value_reference]
                    start, end = value_at(signal, begin, begin), value_at(signal, begin + step, begin)
                    fmu.setReal(reference, [start])
                    fmu.setRealInputDerivatives(reference, [1], [(end - start) / step])
                fmu.doStep(begin, step)
        return np.column_stack([np.interp(samples, points[read], y) for y in out[read].T])

    def _apply(self, fmu: Any, signals: tuple[InputSignal, ...], t: float, segment: float) -> None:
        for signal in signals:
            fmu.setReal([self.problem.model.input(signal.name).value_reference], [value_at(signal, t, segment)])


class CosimulationEngine:
    """The functions of the compiled engine that :func:`worker_main.serve` calls, with FMPy doing the runs."""

    def __init__(self, engine: ctypes.CDLL) -> None:
        engine.ab_take.restype = ctypes.c_int64
        engine.ab_take.argtypes = [ctypes.c_void_p]
        self._engine = engine
        self._instances: dict[Path, _Instance] = {}

    def ab_open(self, path: bytes, *_: Any) -> CosimulationRuns:
        """The problem that the parent wrote."""
        problem, folder, substeps = pickle.loads(Path(os.fsdecode(path)).read_bytes())
        instance = self._instances.setdefault(folder, _Instance(problem.model, folder))
        return CosimulationRuns(problem, instance, substeps)

    def ab_close(self, runs: CosimulationRuns) -> None:
        """Close the FMU."""

    def ab_batch(self, runs: CosimulationRuns, base: int, job: int, slot: int, first: int) -> int:
        """Work until no task is left."""
        return runs.batch(self._engine, base, job, slot, first)

    def ab_load_error(self, runs: CosimulationRuns) -> bytes:
        """Why the FMU could not be loaded."""
        return runs.load_error.encode()


def equal_steps(samples: FloatArray, step: float) -> FloatArray:
    """Return where an FMU that takes steps of one size stops, up to the last sample or one step beyond it."""
    count = int(np.ceil((samples[-1] - samples[0]) / step - STEP_SHARE))
    points = samples[0] + step * np.arange(max(count, 1) + 1)
    near = np.clip(np.rint((samples - samples[0]) / step).astype(int), 0, points.size - 1)
    same = np.abs(points[near] - samples) <= STEP_SHARE * step
    points[near[same]] = samples[same]  # so that a sample is read and not interpolated
    return np.asarray(points)


def communication_points(
    samples: FloatArray, signals: tuple[InputSignal, ...], substeps: int
) -> tuple[FloatArray, FloatArray]:
    """Return where an FMU that takes any step stops, and at what time its inputs are read for each step.

    It stops at the samples, so many times between two of them, and where an input breaks. An input is constant over a
    step: at its value in the middle, so that states are right to second order."""
    steps = np.diff(samples)
    fractions = np.arange(substeps) / substeps
    between = [(samples[:-1, None] + steps[:, None] * fractions).ravel()]
    short = bool(linear_signals(signals))
    between += [s.time[(s.time > samples[0]) & (s.time < samples[-1])] for s in signals]
    if short:
        between.append(samples[1:] - LAST_STEP * steps)
    points = np.unique(np.concatenate([samples, *between]))
    tiny = 1e-12 * max(abs(samples[0]), abs(samples[-1]))
    keep = np.append(np.diff(points) > tiny, True) | np.isin(points, samples)
    points = points[keep]
    times = points[:-1] + 0.5 * np.diff(points)
    return points, np.where(np.isin(points[1:], samples), points[1:], times) if short else times
