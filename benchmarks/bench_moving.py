"""What a reading costs where the input moves at each sample: ``python benchmarks/bench_moving.py``."""

from __future__ import annotations

import csv
import ctypes
import json
import subprocess
import tempfile
import time as clock
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import update

from aero_bayes.export import export_fmu
from aero_bayes.export.build import c_compiler
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

ROOT = Path(__file__).resolve().parents[1]
AERO = ("R_a", "c_m", "J_r", "k_d", "k_t", "D_p", "K_sp", "L_a")
RUNS = 10  # runs a call, so that the call itself costs little beside them


@dataclass(frozen=True)
class Rig:
    """A model with the recording that drives it."""

    name: str
    source: Path | None
    recording: Path | None
    outputs: tuple[str, ...]
    input: str
    parameters: tuple[str, ...]


RIGS = (
    Rig("aero_two_jumps", None, None, ("i_m", "omega_m", "theta"), "V_m", AERO),
    Rig("aero_moving", None, None, ("i_m", "omega_m", "theta"), "V_m", AERO),
    Rig("coil", ROOT / "studies/real_rigs/coil", ROOT.parent / "shared/rigs/coil/train.csv", ("i",), "u", ("L", "R")),
    Rig(
        "battery",
        ROOT / "studies/real_rigs/battery",
        ROOT.parent / "shared/rigs/battery/train.csv",
        ("v",),
        "i",
        ("E_0", "k", "R"),
    ),
    Rig("cart", ROOT / "examples/cart", ROOT / "examples/cart/train.csv", ("position",), "F", ("m", "k", "d")),
)


def drive(rig: Rig) -> tuple[np.ndarray, InputSignal]:
    """Return the sample times and the input of a rig, held between its values."""
    if rig.recording is not None:
        with rig.recording.open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        time = np.array([float(row["time"]) for row in rows])
        return time, InputSignal(rig.input, time, np.array([float(row[rig.input]) for row in rows]))
    time = np.linspace(0.0, 40.0, 2001)
    if rig.name == "aero_two_jumps":
        return time, InputSignal(rig.input, np.array([0.0, 20.0]), np.array([24.0, 0.0]))
    noise = np.random.default_rng(3).standard_normal(time.size)
    return time, InputSignal(rig.input, time, 12.0 + 6.0 * np.sin(0.6 * time) + 3.0 * np.sin(4.4 * time + 1.0) + noise)


def pose(rig: Rig, folder: Path) -> tuple[Problem, np.ndarray]:
    """Return the problem at the default tolerance and the model's own values."""
    name = "Aero.Systems.OneDof" if rig.source is None else "Rig"
    sources = [] if rig.source is None else [rig.source / "Rig.mo"]
    model = Model.load(export_fmu(name, folder / f"{rig.name}.fmu", sources=sources))
    time, signal = drive(rig)
    what = Experiment(time, rig.outputs, (signal,), measured=np.zeros((time.size, len(rig.outputs))))
    values = np.array([[model.parameter(parameter).start for parameter in rig.parameters]], dtype=float)
    return Problem(model, (what,), (tuple(ParameterTarget(p) for p in rig.parameters),)), values


def seconds(call: Any, rounds: int) -> float:
    """Return the least computing time of a call over the rounds."""
    call()
    found = []
    for _ in range(rounds):
        begin = clock.process_time()
        call()
        found.append(clock.process_time() - begin)
    return min(found)


class PlainLoops:
    """The same models in plain C (plain_loops.c), with a fixed step as fine as the engine is exact."""

    ORDER = {  # noqa: RUF012
        "aero": ("R_a", "L_a", "c_m", "J_r", "k_d", "k_t", "J_p", "D_p", "K_sp", "D_t"),
        "coil": ("L", "R"),
        "battery": ("E_0", "k", "R"),
        "cart": ("m", "k", "d"),
    }
    CLOSE = 1e-6  # largest error over the range
    MOST_PARTS = 1024  # steps between two samples

    def __init__(self, folder: Path) -> None:
        source, library = Path(__file__).with_name("plain_loops.c"), folder / "plain_loops.so"
        flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", str(source), "-o", str(library)]
        subprocess.run([*c_compiler(), *flags], check=True)
        self._library = ctypes.CDLL(str(library))

    def ns_per_reading(self, rig: Rig, model: Model, exact: np.ndarray, rounds: int) -> float:
        """Return what a reading costs with the fewest steps, a power of two of them, that are exact enough."""
        time, signal = drive(rig)
        name = rig.name.partition("_")[0]
        level = signal.values[np.searchsorted(signal.time, time + 1e-9, side="right") - 1]
        values = {p: float(model.parameter(p).start) for p in self.ORDER[name]}
        if name == "aero":
            values["J_r"] += float(model.parameter("J_s").start)
        given, out = np.array(list(values.values())), np.empty(exact.shape)
        arrays = [a.ctypes.data_as(ctypes.c_void_p) for a in (time, level, given, out)]
        loop, parts = self._library[f"{name}_loop"], 1

        def call() -> None:
            loop(ctypes.c_long(time.size), *arrays[:3], ctypes.c_long(parts), arrays[3])

        while True:
            call()
            if np.all(np.abs(out - exact).max(axis=0) <= self.CLOSE * np.ptp(exact, axis=0)):
                return 1e9 * seconds(lambda: [call() for _ in range(RUNS)], rounds) / (RUNS * time.size)
            parts *= 2
            if parts > self.MOST_PARTS:
                raise RuntimeError(f"the plain loop of {rig.name} does not meet the engine")


def rows(rounds: int = 5) -> dict[str, Any]:
    """Measure all rigs whose recordings are at hand.

    Returns
    -------
    dict
        ``ns_per_reading`` by rig, ``over_plain_c``, the same over a plain loop in C, ``gradient_over_plain`` of the
        AERO by the number of parameters, and ``max_relative_error_moving``, the largest error over the range beside a
        run at a tolerance of 1e-10.
    """
    cost: dict[str, float] = {}
    over: dict[str, float] = {}
    gradient: dict[str, float] = {}
    error = 0.0
    white = np.array([1.0, 0.0, 0.0])
    with tempfile.TemporaryDirectory() as name, WorkerPool(0) as here:
        floor = PlainLoops(Path(name))
        for rig in RIGS:
            if rig.recording is not None and not rig.recording.exists():
                continue
            problem, values = pose(rig, Path(name))
            many, readings = np.repeat(values, RUNS, axis=0), problem.experiments[0].time.size
            tight = replace(problem, settings=SolverSettings(1e-10, 1e-10, max_steps=10_000_000, time_limit=100.0))
            with NativeSimulator(problem, pool=here) as s, NativeSimulator(tight, pool=here) as reference:
                exact, out = (x.simulate(values).outputs[0][0] for x in (reference, s))
                plain = seconds(lambda s=s, many=many: s.log_likelihood(many, white), rounds)
                cost[rig.name] = 1e9 * plain / (RUNS * readings)
                over[rig.name] = cost[rig.name] / floor.ns_per_reading(rig, problem.model, exact, rounds)
                if rig.name == "aero_two_jumps":
                    continue
                error = max(error, float(np.max(np.abs(out - exact) / np.ptp(exact, axis=0))))
                for q in (4, 8) if rig.name == "aero_moving" else ():
                    active = range(q)
                    call = lambda s=s, many=many, active=active: s.gauss_newton(many, white, active=active)  # noqa: E731
                    gradient[str(q)] = seconds(call, rounds) / plain
    return {
        "ns_per_reading": cost,
        "over_plain_c": over,
        "gradient_over_plain": gradient,
        "max_relative_error_moving": error,
    }


def run(out: Path, rounds: int = 5) -> None:
    """Time inputs that move and write the figures to ``out``/bench.json."""
    found = rows(min(rounds, 5))
    print(json.dumps(found, indent=1), flush=True)
    update(out / "bench.json", found, [], ())


if __name__ == "__main__":
    print(json.dumps(rows(), indent=1))
