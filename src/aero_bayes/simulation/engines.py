"""Picks the simulator by name, so that the reference implementation is one flag away."""

from __future__ import annotations

import os
import pickle
import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.simulation.averages import AveragingSimulator
from aero_bayes.simulation.batches import Batches
from aero_bayes.simulation.cosimulation_runs import CosimulationEngine
from aero_bayes.simulation.function_model import FunctionModel, FunctionSimulator
from aero_bayes.simulation.interface import (
    ClosedAtExit,
    DelayTarget,
    Engine,
    Outcome,
    Problem,
    Simulator,
    StartTarget,
    Trajectories,
)
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.problem_checks import (
    check_active,
    check_problem,
    check_values,
    linear_signals,
    target_scale,
)
from aero_bayes.simulation.workers import WorkerPool

MAX_SUBSTEPS = 64
_STEP_ERROR_GOAL = 1e-5  # of an output's range, between a step and its halves
_RELATIVE_STEP = 1e-3  # of the differences: the FMU's solver is no smoother than that


class CosimulationSimulator(ClosedAtExit):
    """Runs a problem whose model has co-simulation only."""

    def __init__(self, problem: Problem, workers: int | None = None) -> None:
        _check(problem)
        self.problem = problem
        self._workers = workers
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

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.problem, self._workers)

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

    def simulate(self, values: FloatArray, *, active: Sequence[int] | None = None) -> Trajectories:
        """Trajectories; with ``active`` also differences for those columns. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        columns = check_active(self.problem, active if active is not None else [])
        batches = self._settle(values)
        found = batches.trajectories(values)
        if active is None:
            return found
        slopes = tuple(np.zeros((*out.shape, len(columns))) for out in found.outputs)
        outcomes = found.outcomes.copy()
        for place, column in enumerate(columns):
            scale = max(target_scale(self.problem.model, row[column]) for row in self.problem.targets)
            size = np.where(values[:, column] != 0.0, np.abs(values[:, column]), scale)
            step = _RELATIVE_STEP * size
            sides = np.repeat(values, 2, axis=0)
            sides[0::2, column] += step
            sides[1::2, column] -= step
            ran = batches.trajectories(sides)
            failed = np.maximum(ran.outcomes[0::2], ran.outcomes[1::2])
            outcomes = np.where(outcomes == Outcome.OK, failed, outcomes)
            for e, out in enumerate(ran.outputs):
                if self.problem.targets[e][column] is not None:
                    slopes[e][..., place] = (out[0::2] - out[1::2]) / (2.0 * step)[:, None, None]
        for e, out in enumerate(found.outputs):
            out[outcomes[:, e] != Outcome.OK] = np.nan
        return Trajectories(found.outputs, slopes, outcomes)


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


def open_simulator(
    problem: Problem, engine: Engine = "native", workers: int | None = None, pool: WorkerPool | None = None
) -> Simulator:
    """Open a simulator for a problem."""
    if any(set(e.windows) & set(e.outputs) for e in problem.experiments):
        return AveragingSimulator(problem, partial(open_simulator, engine=engine, workers=workers, pool=pool))
    if problem.process is not None and (engine != "native" or problem.model.interface != "model exchange"):
        raise InputError(f"{problem.model.path}: process noise needs the native engine and an FMU with Model Exchange")
    if isinstance(problem.model, FunctionModel):
        return FunctionSimulator(problem)
    if problem.model.interface == "co-simulation" and engine in ("native", "fmpy"):
        return CosimulationSimulator(problem, workers if pool is None else pool.size)
    if engine == "native":
        return NativeSimulator(problem, workers, pool)
    if engine == "fmpy":
        from aero_bayes.simulation.fmpy_reference import FmpySimulator

        return FmpySimulator(problem)
    raise InputError(f"engine {engine!r} is not known (native or fmpy)")
