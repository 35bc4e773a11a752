"""Opens the simulator that a model needs."""

from __future__ import annotations

from functools import partial

from aero_bayes.errors import InputError
from aero_bayes.simulation.averages import AveragingSimulator
from aero_bayes.simulation.cosimulation_runs import CosimulationSimulator
from aero_bayes.simulation.function_model import FunctionModel, FunctionSimulator
from aero_bayes.simulation.interface import Problem, Simulator
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool


def open_simulator(problem: Problem, workers: int | None = None, pool: WorkerPool | None = None) -> Simulator:
    """Open a simulator for a problem."""
    if any(set(e.windows) & set(e.outputs) for e in problem.experiments):
        return AveragingSimulator(problem, partial(open_simulator, workers=workers, pool=pool))
    if problem.process is not None and problem.model.interface != "model exchange":
        raise InputError(f"{problem.model.path}: process noise needs an FMU with Model Exchange")
    if isinstance(problem.model, FunctionModel):
        return FunctionSimulator(problem)
    if problem.model.interface == "co-simulation":
        return CosimulationSimulator(problem, workers if pool is None else pool.size)
    return NativeSimulator(problem, workers, pool)
