"""All speed measurements: ``python benchmarks/bench.py --out reports`` writes ``bench.json`` and ``bench.svg``."""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from pathlib import Path

import bench_engine
import bench_lanes
import bench_loops
import bench_moving
import bench_plot
import bench_sampling
from harness import Goal

GOALS = (
    Goal("engine_over_fmpy_me", "engine over FMPy ME with CVode, one core", 80.0),
    Goal("max_relative_error", "its largest error over the output's range", 1e-5, at_most=True),
    Goal("lanes_over_single", "several runs at a time over one by one, least of three models", 2.5),
    Goal("max_relative_error_moving", "largest error where inputs move, over the range", 1e-6, at_most=True),
    Goal("two_cores_over_one", "two cores over one", 1.8),
    Goal("sensitivities_over_plain", "eight sensitivities, cost over the plain run", 5.0, at_most=True),
    Goal("ess_per_s_over_stretch", "effective samples/s over emcee's stretch move, same engine", 10.0),
    Goal("ess_per_s_over_fmpy", "effective samples/s over emcee on FMPy (projected)", 500.0),
    Goal(
        "simulations_an_effective_sample_with_a_delay",
        "simulations per effective sample on a recording with a delay",
        5.0,
        at_most=True,
    ),
    Goal("time_over_linear_in_samples", "time for 10 times the samples, over linear", 1.1, at_most=True),
    Goal("time_over_linear_in_recordings", "time for 16 times the recordings, over linear", 1.1, at_most=True),
    Goal("memory_growth_mib", "memory, batch of 100,000 over one of 20,000 (MiB)", 1.0, at_most=True),
    Goal("correlated_over_white", "correlated noise over white, 30,001 samples", 2.0, at_most=True),
)
OTHERS = {
    "ess_per_s_over_pints_on_fmpy": "effective samples/s over PINTS on FMPy (projected)",
    "swarm_evaluations_per_s_over_pints_on_fmpy": "swarm's evaluations/s over PINTS' swarm on FMPy",
    "gauss_newton_over_likelihood": "Gauss-Newton products (8), cost over the likelihood",
}


def print_goals(path: Path) -> None:
    """Print the figures with their goals, met or not."""
    report = json.loads(path.read_text())
    print(f"\n{'figure':<66} {'goal':>10} {'measured':>12}")
    for goal in GOALS:
        print(goal.line(report))
    for key, text in OTHERS.items():
        value = report.get(key)
        print(f"{text:<66} {'':>10} " + (f"{value:>12.4g}" if value is not None else "not measured"))


def main() -> None:
    """Run every part, each of which adds its keys and rows to the report; then the goals and the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    began, failed = time.perf_counter(), []
    for part in (bench_engine, bench_moving, bench_lanes, bench_sampling, bench_loops):
        start = time.perf_counter()
        try:
            part.run(options.out, options.rounds)
        except Exception:  # the figures of the other parts are wanted all the same
            traceback.print_exc()
            failed.append(part.__name__)
        print(f"{part.__name__}: {time.perf_counter() - start:.0f} s", flush=True)
    print_goals(options.out / "bench.json")
    bench_plot.draw_bench(options.out / "bench.json", options.out / "bench.svg")
    print(f"\n{time.perf_counter() - began:.0f} s; written: {options.out / 'bench.json'}, {options.out / 'bench.svg'}")
    if failed:
        sys.exit(f"not measured: {', '.join(failed)}")


if __name__ == "__main__":
    main()
