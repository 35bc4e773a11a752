"""Picks the simulator by name, so that the reference implementation is one flag away."""

from __future__ import annotations

from typing import Literal

from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import Problem, Simulator
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.python_model import PythonModel, PythonSimulator
from aero_bayes.simulation.workers import WorkerPool

Engine = Literal["native", "fmpy"]


def engine_of(simulator: Simulator) -> str:
    """Return what runs the problem, in words for a report, which may not be what was asked for."""
    return str(getattr(simulator, "engine", type(simulator).__name__))


def open_simulator(
    problem: Problem, engine: Engine = "native", workers: int | None = None, pool: WorkerPool | None = None
) -> Simulator:
    """Open a simulator for a problem."""
    if problem.process is not None and (engine != "native" or problem.model.interface != "model exchange"):
        raise InputError(f"{problem.model.path}: process noise needs the native engine and an FMU with Model Exchange")
    if isinstance(problem.model, PythonModel):
        return PythonSimulator(problem)
    if problem.model.interface == "co-simulation" and engine in ("native", "fmpy"):
        from aero_bayes.simulation.cosimulation import CosimulationSimulator

        return CosimulationSimulator(problem, workers if pool is None else pool.size)
    if engine == "native":
        return NativeSimulator(problem, workers, pool)
    if engine == "fmpy":
        from aero_bayes.simulation.fmpy_reference import FmpySimulator

        return FmpySimulator(problem)
    raise InputError(f"engine {engine!r} is not known (native or fmpy)")
