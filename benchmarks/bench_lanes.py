"""Batches of parameter vectors with several runs at a time, beside the same batches one by one.

``python benchmarks/bench_lanes.py`` prints the rows; :func:`lanes` returns them for ``bench.py``. Computing time of
this process, in pairs round by round, so that a busy machine changes little.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from bench_engine import nominal, paper_experiment, paper_problem
from harness import TimingRow, update

from aero_bayes.export import export_fmu
from aero_bayes.simulation import (
    Experiment,
    InputSignal,
    Model,
    NativeSimulator,
    ParameterTarget,
    Problem,
    WorkerPool,
)

ROOT = Path(__file__).parents[1]
GROUP = "lanes"
WHITE = np.array([1.0, 0.0, 0.0])
KINDS = ("trajectories", "log-likelihood")


def cart_problem(folder: Path) -> Problem:
    """Pose the example's cart on its own recording."""
    example = ROOT / "examples" / "cart"
    model = Model.load(export_fmu("Rig", folder / "cart.fmu", sources=example / "Rig.mo"))
    table = np.genfromtxt(example / "train.csv", delimiter=",", names=True)
    force = InputSignal("F", table["time"], table["F"])
    what = Experiment(table["time"], ("position",), (force,), measured=table["position"][:, None])
    return Problem(model, (what,), (tuple(ParameterTarget(name) for name in ("k", "d", "m")),))


def coil_problem(folder: Path) -> Problem:
    """Pose the electromagnet under steps of random height that last 20 to 80 ms, 4,500 readings."""
    source = ROOT / "studies" / "real_rigs" / "coil" / "Rig.mo"
    model = Model.load(export_fmu("Rig", folder / "coil.fmu", sources=source))
    rng = np.random.default_rng(0)
    at = np.cumsum(rng.uniform(0.02, 0.08, 90)) - 0.02
    grid = 1e-3 * np.arange(4500)
    signal = InputSignal("u", np.append(0.0, at), rng.uniform(0.0, 12.0, 91))
    what = Experiment(grid, ("i",), (signal,), measured=np.zeros((grid.size, 1)))
    return Problem(model, (what,), (tuple(ParameterTarget(name) for name in ("L", "R")),))


def population(problem: Problem, count: int) -> np.ndarray:
    """Draw parameter vectors about the model's own values, 10 % wide."""
    base = np.array([problem.model.parameter(t.name).start for t in problem.targets[0]], dtype=float)
    return base * np.exp(0.1 * np.random.default_rng(0).standard_normal((count, base.size)))


@contextmanager
def _one_by_one(yes: bool) -> Iterator[None]:
    before = os.environ.get("AERO_BAYES_LANES")
    os.environ["AERO_BAYES_LANES"] = "0" if yes else "1"
    try:
        yield
    finally:
        os.environ.pop("AERO_BAYES_LANES")
        if before is not None:
            os.environ["AERO_BAYES_LANES"] = before


def _time_pair(
    name: str, problem: Problem, values: np.ndarray, rounds: int
) -> tuple[list[TimingRow], dict[str, float]]:
    """Time both kinds of batches with lanes and one by one; also the ratio of their medians by kind."""
    seconds: dict[tuple[str, bool], list[float]] = {(kind, single): [] for kind in KINDS for single in (True, False)}
    with WorkerPool(0) as pool:
        both = {}
        for single in (True, False):
            with _one_by_one(single):
                both[single] = NativeSimulator(problem, pool=pool)
                both[single].simulate(values[:2])  # opens the problem, which decides
        first, second = (both[single].simulate(values[:8]).outputs[0] for single in (True, False))
        error = float(np.max(np.abs(first - second) / np.ptp(first, axis=1, keepdims=True)))
        calls = {
            "trajectories": lambda s: s.simulate(values),
            "log-likelihood": lambda s: s.log_likelihood(values, WHITE),
        }
        for _ in range(rounds + 1):
            for (kind, single), times in seconds.items():
                began = time.process_time()
                calls[kind](both[single])
                times.append((time.process_time() - began) / len(values))
    rows, ratios = [], {}
    for (kind, single), times in seconds.items():
        low, middle, high = statistics.quantiles(times[1:], n=4) if rounds > 1 else times[1:] * 3
        how = "one by one" if single else "in lanes"
        rows.append(TimingRow(GROUP, f"{name}, {kind}, {how}", middle, low, high, None if single else error))
    for kind in KINDS:
        ratios[kind] = statistics.median(seconds[kind, True][1:]) / statistics.median(seconds[kind, False][1:])
    return rows, ratios


def lanes(rounds: int = 5) -> tuple[list[TimingRow], dict[str, float]]:
    """Time the three models.

    Parameters
    ----------
    rounds : int
        Measurements of each row.

    Returns
    -------
    list of TimingRow
        Seconds a run; the errors are those between the two ways, over the range.
    dict of str to float
        ``lanes_over_single``: the smallest of the ratios of single runs to lanes; and each model's under
        ``lanes_over_single_NAME_KIND``.
    """
    rows: list[TimingRow] = []
    keys: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        aero = paper_problem(Model.load(export_fmu("Aero.Systems.OneDof", folder / "OneDof.fmu")), paper_experiment())
        cases = {
            "aero": (aero, nominal(aero.model, 400)),
            "cart": (cart := cart_problem(folder), population(cart, 400)),
            "coil": (coil := coil_problem(folder), population(coil, 400)),
        }
        for case, (problem, values) in cases.items():
            more, ratios = _time_pair(case, problem, values, rounds)
            rows += more
            keys |= {f"lanes_over_single_{case}_{kind}": ratio for kind, ratio in ratios.items()}
    keys["lanes_over_single"] = min(keys.values())
    return rows, keys


def run(out: Path, rounds: int = 5) -> None:
    """Time lanes and write rows and keys to ``out``/bench.json."""
    rows, keys = lanes(min(rounds, 5))
    for row in rows:
        print(row.line(), flush=True)
    update(out / "bench.json", keys, rows, (GROUP,))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rows, keys = lanes(parser.parse_args().rounds)
    for row in rows:
        print(row.line())
    for key, value in keys.items():
        print(f"{key:<50} {value:.2f}")


if __name__ == "__main__":
    main()
