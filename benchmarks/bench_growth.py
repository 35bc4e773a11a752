"""How time grows with the number of states, and memory with the size of a batch: ``bench_engine`` runs it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from harness import Route, TimingRow, time_routes

from aero_bayes.export import export_fmu
from aero_bayes.simulation import (
    Experiment,
    InputSignal,
    Model,
    NativeSimulator,
    ParameterTarget,
    Problem,
    SolverSettings,
    WorkerPool,
)

WHITE = np.array([1.0, 0.0, 0.0])
SIZES = (4, 16, 64)


def ladder(n: int) -> str:
    """Write the Modelica of an RC ladder of n sections: n states, each coupled to its neighbours."""
    lines = [f"model Ladder{n}", "  parameter Real R = 1.0;", "  parameter Real C = 0.1;", "  input Real u;"]
    lines += ["  output Real y;", *(f"  Real v{i}(start = 0, fixed = true);" for i in range(n)), "equation"]
    for i in range(n):
        left = "u" if i == 0 else f"v{i - 1}"
        onward = f" - (v{i} - v{i + 1}) / R" if i + 1 < n else ""
        lines.append(f"  C * der(v{i}) = ({left} - v{i}) / R{onward};")
    return "\n".join([*lines, f"  y = 2 * v{n - 1};", f"end Ladder{n};", ""])


def ladder_problem(n: int, folder: Path) -> Problem:
    """Pose the ladder's step response, 2,001 samples, two parameters."""
    source = folder / f"Ladder{n}.mo"
    source.write_text(ladder(n))
    model = Model.load(export_fmu(f"Ladder{n}", folder / f"Ladder{n}.fmu", sources=[source]))
    signal = InputSignal("u", np.array([0.0, 20.0]), np.array([24.0, 0.0]))
    experiment = Experiment(np.linspace(0.0, 40.0, 2001), ("y",), (signal,), measured=np.zeros((2001, 1)))
    return Problem(model, (experiment,), ((ParameterTarget("R"), ParameterTarget("C")),))


def states(folder: Path, rounds: int) -> dict[str, TimingRow]:
    """Time log-likelihoods and Gauss-Newton products of models with more and more states."""
    routes = []
    values = np.tile([1.0, 0.1], (5, 1))
    with WorkerPool(0) as here:
        for n in SIZES:
            s = NativeSimulator(ladder_problem(n, folder), pool=here)
            routes += [
                Route("states", f"{n} states", lambda s=s: s.log_likelihood(values, WHITE), 5),
                Route(
                    "states",
                    f"{n} states, Gauss-Newton, 2",
                    lambda s=s: s.gauss_newton(values, WHITE, active=[0, 1]),
                    5,
                ),
            ]
        return time_routes(routes, rounds)


def peak_mib(process: int) -> float:
    """Return the most memory that a process has held, in MiB."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1024.0
    return float("nan")


def memory(folder: Path, small: int = 20_000, large: int = 100_000) -> float:
    """Measure by how many MiB shared memory and workers together grow from a batch of `small` to one of `large`."""
    what = ladder_problem(4, folder)
    short = Experiment(np.linspace(0.0, 1.0, 51), ("y",), what.experiments[0].inputs, measured=np.zeros((51, 1)))
    fast = Problem(what.model, (short,), what.targets, settings=SolverSettings(1e-3, 1e-3))
    with WorkerPool(1) as pool, NativeSimulator(fast, pool=pool) as simulator:

        def held(n: int) -> float:
            simulator.log_likelihood(np.tile([1.0, 0.1], (n, 1)), WHITE)
            return pool.memory.size / 2**20 + sum(peak_mib(p) for p in pool.processes)

        before = held(small)
        return held(large) - before
