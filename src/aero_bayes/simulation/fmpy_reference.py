"""The reference simulator: FMPy's Model Exchange interface with CVode, segment by segment between input jumps.

Slow and plain on purpose: it shares no code with the native engine beyond the contract, and is what the engine is
tested against. Sensitivities are central differences of whole trajectories at a tightened tolerance.
"""

from __future__ import annotations

import ctypes
import time as clock
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.sundials import CVodeSolver

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.files import ScratchFolder
from aero_bayes.simulation.cosimulation_runs import open_fmu, set_input
from aero_bayes.simulation.interface import InputSignal, Outcome, Problem, SolverSettings, StartTarget
from aero_bayes.simulation.problem_checks import SingleRuns, check_problem, parameters_of_run, signals_of_run, value_at
from aero_bayes.simulation.worker_group import LoadError


class _TimedOutError(Exception):
    """The time limit of a run passed."""


class FmpySimulator(SingleRuns):
    """Runs a problem with FMPy."""

    def __init__(self, problem: Problem) -> None:
        check_problem(problem)
        self.problem = problem
        if problem.model.interface != "model exchange":
            raise InputError(f"{problem.model.path}: has no Model Exchange; see CosimulationSimulator")
        self._scratch = ScratchFolder()
        problem.model.unpack(self._scratch.path)
        try:
            self._fmu = open_fmu(problem.model, self._scratch.path)
        except LoadError as error:
            raise LoadError(f"{problem.model.path}: its binary cannot be loaded: {error}") from None
        self._slopes_pointer = (ctypes.c_double * max(1, len(problem.model.states)))()
        self._fresh = True
        self._closed = False

    def close(self) -> None:
        """Free the model and remove what was unpacked."""
        if not self._closed:
            self._closed = True
            self._fmu.freeInstance()
            self._scratch.close()

    # -- one run -------------------------------------------------------------------------------------------------------

    def _start(self, number: int, values: FloatArray, signals: tuple[InputSignal, ...]) -> float:
        problem, fmu = self.problem, self._fmu
        model, experiment = problem.model, problem.experiments[number]
        if not self._fresh:
            fmu.reset()
        self._fresh = False
        starts = {model.states[model.state_index(name)]: value for name, value in experiment.start.items()}
        parameters = parameters_of_run(problem, number, values)
        setting = {model.parameter(name): value for name, value in parameters.items()}
        for value, target in zip(values, problem.targets[number], strict=True):
            if isinstance(target, StartTarget):
                starts[model.states[model.state_index(target.state)]] = float(value)
        begin = float(experiment.time[0])
        fmu.setupExperiment(startTime=begin)
        for variable, value in [*setting.items(), *((v, x) for v, x in starts.items() if v.settable_start)]:
            fmu.setReal([variable.value_reference], [value])
        self._apply(signals, begin, begin)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        next_event = self._iterate()
        fmu.enterContinuousTimeMode()
        if model.states and starts:
            x = np.zeros(len(model.states))
            pointer = x.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
            fmu.getContinuousStates(pointer, x.size)
            for variable, value in starts.items():
                x[model.state_index(variable.name)] = value
            fmu.setContinuousStates(pointer, x.size)
        return next_event

    def _apply(self, signals: tuple[InputSignal, ...], t: float, segment: float) -> None:
        for signal in signals:
            set_input(self._fmu, self.problem.model.input(signal.name), value_at(signal, t, segment))

    def _iterate(self) -> float:
        """Event iteration; the time of the next time event."""
        for _ in range(1000):
            more, stop, _, _, defined, when = self._fmu.newDiscreteStates()
            if stop:
                raise FMICallException("fmi2NewDiscreteStates", 3)
            if not more:
                return float(when) if defined else np.inf
        raise FMICallException("fmi2NewDiscreteStates", 3)

    def _settle(self) -> None:
        """Ask for the derivatives: some FMUs solve their algebraic loops only then; outputs read first are stale."""
        self._fmu.getDerivatives(self._slopes_pointer, len(self.problem.model.states))

    def _indicators(self, pointer: Any, size: int) -> None:
        self._settle()
        self._fmu.getEventIndicators(pointer, size)

    def _read(self, variables: Sequence[Any]) -> list[float]:
        self._settle()
        get = {"real": self._fmu.getReal, "integer": self._fmu.getInteger, "boolean": self._fmu.getBoolean}
        return [float(get[v.kind]([v.value_reference])[0]) for v in variables]

    def _simulate_one(self, number: int, values: FloatArray, settings: SolverSettings) -> FloatArray:
        model, experiment, fmu = self.problem.model, self.problem.experiments[number], self._fmu
        signals = signals_of_run(experiment, self.problem.targets[number], values)
        deadline = clock.thread_time() + settings.time_limit
        next_event = self._start(number, values, signals)
        variables = [model.output(name) for name in experiment.outputs]
        samples = experiment.time
        out = np.empty((samples.size, len(variables)))
        t, end, done = float(samples[0]), float(samples[-1]), 0
        tiny = 1e-13 * max(abs(t), abs(end))
        moving = tuple(signal for signal in signals if signal.interpolation == "linear")
        breaks = np.unique(np.concatenate([[np.inf], *(s.time for s in signals)]))
        segment = [t]

        def set_time(now: float) -> None:
            fmu.setTime(now)
            self._apply(moving, now, segment[0])  # held ones may be discrete: those are set at events only

        solver: CVodeSolver | None = None
        while True:
            stop = min(end, float(breaks[np.searchsorted(breaks, t + tiny, side="right")]), next_event)
            solver = solver or self._new_solver(set_time, t, settings)
            event = False
            while t < stop - tiny and not event:
                goal = stop
                if done < samples.size and samples[done] <= t + tiny:
                    set_time(t)
                    out[done] = self._read(variables)
                    done += 1
                    continue
                if done < samples.size and samples[done] < stop - tiny:
                    goal = float(samples[done])
                event, _, t = solver.step(t, goal)
                set_time(t)
                if model.wants_step_callback:
                    ask, terminate = fmu.completedIntegratorStep()
                    if terminate:
                        raise FMICallException("fmi2CompletedIntegratorStep", 3)
                    event = event or bool(ask)
                if clock.thread_time() > deadline:
                    raise _TimedOutError
            if t >= end - tiny and not event and next_event > end + tiny and not np.any(np.abs(breaks - t) <= tiny):
                break
            fmu.enterEventMode()
            segment[0] = t
            self._apply(signals, t, t)
            next_event = self._iterate()
            fmu.enterContinuousTimeMode()
            solver = None
            if t >= end - tiny:
                break
        set_time(t)
        out[done:] = self._read(variables)
        return out

    def _new_solver(self, set_time: Callable[[float], None], start: float, settings: SolverSettings) -> CVodeSolver:
        """CVODE from a time in s on; after an event it begins anew."""
        return CVodeSolver(
            nx=len(self.problem.model.states),
            nz=self.problem.model.event_indicators,
            get_x=self._fmu.getContinuousStates,
            set_x=self._fmu.setContinuousStates,
            get_dx=self._fmu.getDerivatives,
            get_z=self._indicators,
            get_nominals=self._fmu.getNominalsOfContinuousStates,
            set_time=set_time,
            input=SimpleNamespace(apply=set_time),  # called before event indicators are asked for
            startTime=start,
            relativeTolerance=min(settings.relative_tolerance, settings.absolute_tolerance),
            maxNumSteps=settings.max_steps,
        )

    def _run(self, number: int, values: FloatArray, settings: SolverSettings) -> tuple[FloatArray, Outcome]:
        experiment = self.problem.experiments[number]
        out = np.full((experiment.time.size, len(experiment.outputs)), np.nan)
        try:
            found = self._simulate_one(number, values, settings)
        except _TimedOutError:
            return out, Outcome.TIMED_OUT
        except FMICallException:
            return out, Outcome.MODEL_ERROR
        except RuntimeError:
            return out, Outcome.SOLVER_FAILED
        return (found, Outcome.OK) if np.all(np.isfinite(found)) else (out, Outcome.NOT_FINITE)
