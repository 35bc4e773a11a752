"""FMUs that have co-simulation only: FMPy runs them in worker processes, in place of the compiled engine."""

from __future__ import annotations

import contextlib
import ctypes
import os
import pickle
import time as clock
import warnings
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.simulation.batches import Batches
from aero_bayes.simulation.interface import DelayTarget, InputSignal, Outcome, Problem, StartTarget, Trajectories
from aero_bayes.simulation.model_description import ModelDescription, Variable
from aero_bayes.simulation.problem_checks import (
    DifferencedRuns,
    check_problem,
    linear_signals,
    parameters_of_run,
    signal_values,
    signals_of_run,
)
from aero_bayes.simulation.worker_group import LoadError
from aero_bayes.simulation.worker_main import JOB_WORDS, NOT_LOADED, SPENT
from aero_bayes.simulation.workers import WorkerPool

MAX_SUBSTEPS = 64
_STEP_ERROR_GOAL = 1e-5  # of an output's range, between a step and its halves
LAST_STEP = 1e-3  # of a sampling interval, where an input moves linearly
STEP_SHARE = 1e-6  # of a step: samples that are so near to its end are there
_TOTAL, _EXPERIMENTS, _P, _VALUES, _OUTCOME, _TABLE = map(
    JOB_WORDS.index, ("total", "experiments", "p", "values", "outcomes", "table")
)


class _Slave3(FMU3Slave):  # type: ignore[misc]
    """FMI 3.0 under the names of FMI 2.0."""

    def setupExperiment(self, startTime: float = 0.0) -> None:
        self._begin = startTime

    def enterInitializationMode(self) -> None:
        super().enterInitializationMode(startTime=self._begin)

    def setReal(self, references: list[int], values: list[float]) -> None:
        self.setFloat64(references, values)

    def getReal(self, references: list[int]) -> Any:
        return self.getFloat64(references)

    def getInteger(self, references: list[int]) -> Any:
        return self.getInt32(references)

    def setInteger(self, references: list[int], values: list[int]) -> None:
        self.setInt32(references, values)

    def doStep(self, time: float, step: float) -> None:
        _, stop, early, reached = super().doStep(time, step)
        if stop or (early and reached < time + step):
            raise RuntimeError("the FMU ended the step early")


def set_input(fmu: Any, variable: Variable, value: float) -> None:
    """Set an input of any kind."""
    reference = [variable.value_reference]
    if variable.kind == "real":
        fmu.setReal(reference, [value])
    elif variable.kind == "boolean":
        fmu.setBoolean(reference, [bool(round(value))])
    else:
        (fmu.setInteger if variable.kind == "integer" else fmu.setInt64)(reference, [round(value)])


def open_fmu(model: ModelDescription, folder: Path) -> Any:
    """Load and instantiate a model unpacked into a folder; what it logs goes nowhere, as a worker prints nothing."""
    path = str(model.binary_in(folder))
    try:
        with contextlib.chdir("."):  # FMPy stays in the binary's folder where loading fails
            fmu = {2: FMU2Slave, 3: _Slave3}[model.fmi_version](
                guid=model.guid,
                unzipDirectory=str(folder),
                modelIdentifier=model.identifier,
                instanceName=model.identifier,
                libraryPath=path,
            )
    except Exception as error:  # FMPy raises no class of its own
        reason = error.__context__ if isinstance(error.__context__, OSError) else error
        if not isinstance(reason, OSError | AttributeError):
            raise
        raise LoadError(str(reason).removeprefix(f"{path}: ")) from error
    fmu.instantiate()
    return fmu


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
            self.fmu = open_fmu(self.model, self.folder)
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
    slot: Any = None

    def stamp(self) -> None:
        """Say in the slot that a run begins, and what was computed before it."""
        self.slot[2], self.slot[1] = clock.process_time_ns(), clock.monotonic_ns()

    def do(self, words: Any, base: int, index: int) -> int:
        """Do one task of a job; returns its outcome."""
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
        except Exception:  # FMPy's own errors have no common class
            self.instance.fmu = None  # not freed: the error may have been fatal
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
        self.stamp()
        fmu = self.instance.ready(new)
        fmu.setupExperiment(startTime=float(samples[0]))
        for name, value in parameters_of_run(problem, number, values).items():
            fmu.setReal([model.parameter(name).value_reference], [value])
        inputs = [model.input(signal.name) for signal in signals]
        for signal, variable in zip(signals, inputs, strict=True):
            set_input(fmu, variable, float(signal_values(signal, samples[0])))
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        get = {"real": fmu.getReal, "integer": fmu.getInteger, "boolean": fmu.getBoolean}
        readings = [(get[v.kind], [v.value_reference]) for v in map(model.output, experiment.outputs)]
        if model.takes_any_step:
            points, times = communication_points(samples, signals, self.substeps)
        else:
            points = equal_steps(samples, model.step_size or experiment.interval)
            times = 0.5 * (points[1:] + points[:-1])
        read = np.isin(points, samples) if model.takes_any_step else np.ones(points.size, dtype=bool)
        begins, lengths = points[:-1], np.diff(points)
        acting = [signal_values(s, times if s.interpolation == "linear" else begins).tolist() for s in signals]
        slopes = []
        for signal in () if model.takes_any_step or not model.interpolates_inputs else linear_signals(signals):
            starts, ends = signal_values(signal, begins), signal_values(signal, points[1:])
            slopes.append(([model.input(signal.name).value_reference], starts, (ends - starts) / lengths))
        out = np.empty((points.size, len(readings)))
        for k in range(points.size):
            if read[k]:
                out[k] = [float(reading(reference)[0]) for reading, reference in readings]
            if k + 1 < points.size:
                for variable, of_steps in zip(inputs, acting, strict=True):
                    set_input(fmu, variable, of_steps[k])
                for reference, starts, rises in slopes:
                    fmu.setReal(reference, [starts[k]])
                    fmu.setRealInputDerivatives(reference, [1], [rises[k]])
                fmu.doStep(float(begins[k]), float(lengths[k]))
        return np.column_stack([np.interp(samples, points[read], y) for y in out[read].T])


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
        """Take tasks from the job's counter until none is left; base, job and slot are addresses."""
        words = (ctypes.c_int64 * len(JOB_WORDS)).from_address(job)
        mine = runs.slot = (ctypes.c_int64 * 3).from_address(slot)
        outcomes = (ctypes.c_uint8 * words[_TOTAL]).from_address(base + words[_OUTCOME])
        index = first if first >= 0 else self._engine.ab_take(job)
        while index < words[_TOTAL]:
            if outcomes[index] == 255:
                runs.stamp()
                mine[0] = index
                try:
                    outcomes[index] = runs.do(words, base, index)
                except _SpentError:
                    return SPENT
                except LoadError as error:
                    runs.load_error = str(error)
                    mine[0], mine[1] = -1, 0
                    return NOT_LOADED
                mine[0] = -1
            index = self._engine.ab_take(job)
        return 0

    def ab_load_error(self, runs: CosimulationRuns) -> bytes:
        """Why the FMU could not be loaded."""
        return runs.load_error.encode()


class CosimulationSimulator(DifferencedRuns):
    """Runs a problem whose model has co-simulation only."""

    relative_step, delay_step = 1e-3, 0.0  # the FMU's solver is no smoother than that

    def __init__(self, problem: Problem, workers: int | None = None) -> None:
        _check(problem)
        self.problem = problem
        self.pool = WorkerPool(None if workers is None else max(1, workers), engine=CosimulationEngine)
        self.substeps = 0
        self._batches: Batches | None = None
        warnings.warn(
            f"{problem.model.path.name} has co-simulation only: its own solver runs it, slowly; sensitivities are "
            "differences of whole runs, initial states cannot be set (Model Exchange has none of these limits)",
            stacklevel=3,
        )
        model, late = problem.model, {s.name for e in problem.experiments for s in linear_signals(e.inputs)}
        if late and not (model.takes_any_step or model.interpolates_inputs):
            warnings.warn(
                f"{model.path.name} takes steps of one size and no slopes of its inputs: an output that "
                f"{', '.join(sorted(late))} feeds directly is half a sampling interval late",
                stacklevel=3,
            )

    def close(self) -> None:
        """Stop the workers and free the model."""
        self.pool.close()

    def _open(self, substeps: int) -> Batches:
        path = self.pool.new_path()
        folder = self.pool.binary(self.problem.model).parents[2]
        partial = path.with_suffix(".part")
        partial.write_bytes(pickle.dumps((self.problem, folder, substeps)))
        os.replace(partial, path)
        return Batches(self.problem, self.pool, path)

    def _settle(self, values: FloatArray) -> Batches:
        """Halve the communication steps until that changes nothing that matters."""
        if self._batches is not None:
            return self._batches
        coarse, change = self._open(1), np.inf
        before = coarse.trajectories(values[:1])
        self.substeps = 1
        while self.problem.model.takes_any_step and 2 * self.substeps <= MAX_SUBSTEPS:
            fine = self._open(2 * self.substeps)
            after = fine.trajectories(values[:1])
            change = _largest_change(before, after)
            if not change > _STEP_ERROR_GOAL:  # or every run failed
                break
            self.pool.forget(coarse.path)
            coarse, before, self.substeps = fine, after, 2 * self.substeps
        if np.isfinite(change) and change > _STEP_ERROR_GOAL:
            warnings.warn(
                f"{self.problem.model.path.name}: halving the communication step still changes its outputs by "
                f"{change:.1e} of their range: its solver is not accurate",
                stacklevel=3,
            )
        if np.all(before.outcomes == Outcome.OK):
            self._batches = coarse
        return coarse

    def outputs(self, values: FloatArray) -> Trajectories:
        """Simulate checked values."""
        return self._settle(values).trajectories(values)


def _largest_change(before: Trajectories, after: Trajectories) -> float:
    """Over all outputs, in units of their range; 0 where a run failed."""
    if np.any(before.outcomes != Outcome.OK) or np.any(after.outcomes != Outcome.OK):
        return 0.0
    changes = [
        float(np.max(np.abs(a - b) / (np.ptp(b, axis=1, keepdims=True) + 1e-300)))
        for a, b in zip(before.outputs, after.outputs, strict=True)
        if a.size
    ]
    return max(changes, default=0.0)


def _check(problem: Problem) -> None:
    model = problem.model
    for experiment, row in zip(problem.experiments, problem.targets, strict=False):
        if experiment.start or any(isinstance(target, StartTarget) for target in row):
            raise InputError(f"{model.path}: has co-simulation only, which lets no initial state be set")
        if model.takes_any_step:
            continue
        if any(isinstance(target, DelayTarget) for target in row):
            raise InputError(f"{model.path}: takes steps of one size only: an input delay needs others")
    check_problem(problem)


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
