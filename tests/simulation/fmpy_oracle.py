"""What the engine is held against: FMPy's Model Exchange of FMI 2.0 with CVode, segment by segment between jumps."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from fmpy.fmi2 import FMU2Model
from fmpy.sundials import CVodeSolver

from aero_bayes.files import ScratchFolder
from aero_bayes.simulation.cosimulation_runs import set_input
from aero_bayes.simulation.interface import InputSignal, Outcome, Problem, StartTarget
from aero_bayes.simulation.problem_checks import SingleRuns, parameters_of_run, signal_values, signals_of_run


class FmpySimulator(SingleRuns):
    """Runs a problem with FMPy at a thousandth of its tolerance; slopes are differences of these runs."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.model, self.scratch = problem, problem.model, ScratchFolder()
        self.model.unpack(self.scratch.path)
        self.fmu = FMU2Model(
            guid=self.model.guid,
            unzipDirectory=str(self.scratch.path),
            modelIdentifier=self.model.identifier,
            instanceName="oracle",
        )
        self.fmu.instantiate()
        self.slopes = (ctypes.c_double * max(1, len(self.model.states)))()

    def close(self) -> None:
        self.fmu.freeInstance()
        self.scratch.close()

    def start(self, number: int, values: np.ndarray, signals: tuple[InputSignal, ...]) -> float:
        """Bring the FMU to the first sample; gives the time of its next event."""
        fmu, model, experiment = self.fmu, self.model, self.problem.experiments[number]
        fmu.reset()
        starts = {model.state_index(name): value for name, value in experiment.start.items()}
        for value, target in zip(values, self.problem.targets[number], strict=True):
            if isinstance(target, StartTarget):
                starts[model.state_index(target.state)] = float(value)
        begin = float(experiment.time[0])
        fmu.setupExperiment(startTime=begin)
        for name, value in parameters_of_run(self.problem, number, values).items():
            fmu.setReal([model.parameter(name).value_reference], [value])
        for index, value in starts.items():
            if model.states[index].settable_start:
                fmu.setReal([model.states[index].value_reference], [value])
        self.apply(signals, begin, begin)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        next_event = self.iterate()
        fmu.enterContinuousTimeMode()
        x = np.zeros(len(model.states))
        pointer = x.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        fmu.getContinuousStates(pointer, x.size)
        x[list(starts)] = list(starts.values())
        fmu.setContinuousStates(pointer, x.size)
        return next_event

    def apply(self, signals: tuple[InputSignal, ...], t: float, segment: float) -> None:
        """Set inputs at t within the segment that starts at `segment`, which decides on the side of a jump."""
        for signal in signals:
            value = float(signal_values(signal, t if signal.interpolation == "linear" else segment))
            set_input(self.fmu, self.model.input(signal.name), value)

    def iterate(self) -> float:
        """Event iteration; the time of the next time event."""
        more = True
        while more:
            more, stop, _, _, defined, when = self.fmu.newDiscreteStates()
            assert not stop
        return float(when) if defined else np.inf

    def settle(self) -> None:
        """Ask for the derivatives: some FMUs solve their algebraic loops only then; outputs read first are stale."""
        self.fmu.getDerivatives(self.slopes, len(self.model.states))

    def indicators(self, pointer: Any, size: int) -> None:
        self.settle()
        self.fmu.getEventIndicators(pointer, size)

    def read(self, variables: Sequence[Any]) -> list[float]:
        self.settle()
        get = {"real": self.fmu.getReal, "integer": self.fmu.getInteger, "boolean": self.fmu.getBoolean}
        return [float(get[v.kind]([v.value_reference])[0]) for v in variables]

    def run_once(self, number: int, values: np.ndarray) -> tuple[np.ndarray, Outcome]:
        experiment, fmu = self.problem.experiments[number], self.fmu
        signals = signals_of_run(experiment, self.problem.targets[number], values)
        next_event = self.start(number, values, signals)
        variables, samples = [self.model.output(name) for name in experiment.outputs], experiment.time
        out = np.empty((samples.size, len(variables)))
        t, end, done = float(samples[0]), float(samples[-1]), 0
        tiny = 1e-13 * max(abs(t), abs(end))
        moving = tuple(signal for signal in signals if signal.interpolation == "linear")
        breaks = np.unique(np.concatenate([[np.inf], *(s.time for s in signals)]))
        segment = [t]

        def set_time(now: float) -> None:
            fmu.setTime(now)
            self.apply(moving, now, segment[0])  # held ones may be discrete: those are set at events only

        solver = None
        while True:
            stop = min(end, float(breaks[np.searchsorted(breaks, t + tiny, side="right")]), next_event)
            solver = solver or self.new_solver(set_time, t)
            event = False
            while t < stop - tiny and not event:
                if done < samples.size and samples[done] <= t + tiny:
                    set_time(t)
                    out[done] = self.read(variables)
                    done += 1
                    continue
                goal = float(samples[done]) if done < samples.size and samples[done] < stop - tiny else stop
                event, _, t = solver.step(t, goal)
                set_time(t)
                if self.model.wants_step_callback:
                    ask, terminate = fmu.completedIntegratorStep()
                    assert not terminate
                    event = event or bool(ask)
            if t >= end - tiny and not event and next_event > end + tiny and not np.any(np.abs(breaks - t) <= tiny):
                break
            fmu.enterEventMode()
            segment[0] = t
            self.apply(signals, t, t)
            next_event = self.iterate()
            fmu.enterContinuousTimeMode()
            solver = None
            if t >= end - tiny:
                break
        set_time(t)
        out[done:] = self.read(variables)
        return out, Outcome.OK

    def new_solver(self, set_time: Any, start: float) -> CVodeSolver:
        """CVODE from a time in s on; after an event it begins anew."""
        settings = self.problem.settings
        return CVodeSolver(
            nx=len(self.model.states),
            nz=self.model.event_indicators,
            get_x=self.fmu.getContinuousStates,
            set_x=self.fmu.setContinuousStates,
            get_dx=self.fmu.getDerivatives,
            get_z=self.indicators,
            get_nominals=self.fmu.getNominalsOfContinuousStates,
            set_time=set_time,
            input=SimpleNamespace(apply=set_time),  # called before event indicators are asked for
            startTime=start,
            relativeTolerance=max(1e-12, 1e-3 * min(settings.relative_tolerance, settings.absolute_tolerance)),
            maxNumSteps=10_000_000,
        )
