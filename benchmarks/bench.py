"""All speed measurements: ``python benchmarks/bench.py --out reports`` writes ``bench.json``."""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bench_engine
import bench_loops
import bench_sampling


@dataclass(frozen=True)
class Goal:
    """A figure of the report that has to reach a number."""

    key: str
    text: str
    goal: float
    at_most: bool = False

    def line(self, report: Mapping[str, Any]) -> str:
        """Write the goal for the terminal: figure, goal, met or not."""
        value, goal = report.get(self.key), f"{'<=' if self.at_most else '>='} {self.goal:g}"
        if value is None:
            return f"{self.text:<66} {goal:>10} {'':>12}  not measured"
        met = value <= self.goal if self.at_most else value >= self.goal
        return f"{self.text:<66} {goal:>10} {value:>12.4g}  {'met' if met else 'NOT MET'}"


GOALS = (
    Goal("engine_over_fmpy_me", "engine over FMPy ME with CVode, one core", 80.0),
    Goal("max_relative_error", "its largest error over the output's range", 1e-5, at_most=True),
    Goal("two_cores_over_one", "two cores over one", 1.8),
    Goal("sensitivities_over_plain", "eight sensitivities, cost over the plain run", 5.0, at_most=True),
    Goal("ess_per_s_over_stretch", "effective samples/s over emcee's stretch move, same engine", 10.0),
    Goal("ess_per_s_over_fmpy", "effective samples/s over emcee on FMPy (projected)", 500.0),
)


def main() -> None:
    """Run every part, each of which adds its rows and keys to the report; then print the goals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    began, failed = time.perf_counter(), []
    for part in (bench_engine, bench_sampling, bench_loops):
        start = time.perf_counter()
        try:
            part.run(options.out, options.rounds)
        except Exception:  # the figures of the other parts are wanted all the same
            traceback.print_exc()
            failed.append(part.__name__)
        print(f"{part.__name__}: {time.perf_counter() - start:.0f} s", flush=True)
    report = json.loads((options.out / "bench.json").read_text())
    print(f"\n{'figure':<66} {'goal':>10} {'measured':>12}", *(goal.line(report) for goal in GOALS), sep="\n")
    print(f"\n{time.perf_counter() - began:.0f} s; written: {options.out / 'bench.json'}")
    if failed:
        sys.exit(f"not measured: {', '.join(failed)}")


if __name__ == "__main__":
    main()
