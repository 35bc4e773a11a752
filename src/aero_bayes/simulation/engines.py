"""Picks the simulator by name, so that the reference implementation is one flag away."""

from __future__ import annotations

from typing import Literal

from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import Problem, Simulator
from aero_bayes.simulation.native import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool

Engine = Literal["native", "fmpy"]


def open_simulator(
    problem: Problem, engine: Engine = "native", workers: int | None = None, pool: WorkerPool | None = None
) -> Simulator:
    """Open a simulator for a problem.

    Parameters
    ----------
    problem : Problem
    engine : {"native", "fmpy"}
        The compiled engine, or FMPy's Model Exchange with CVode (slow; the reference).
    workers : int, optional
        Worker processes of the native engine; 0 runs in this process.
    pool : WorkerPool, optional
        Workers shared with other simulators.

    Raises
    ------
    InputError
        For an unknown engine, or a problem that contradicts its model.
    """
    if engine == "native":
        return NativeSimulator(problem, workers, pool)
    if engine == "fmpy":
        from aero_bayes.simulation.fmpy_reference import FmpySimulator

        return FmpySimulator(problem)
    raise InputError(f"engine {engine!r} is not known (native or fmpy)")
