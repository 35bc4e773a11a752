"""A small frame for side-by-side timings: every route runs once a round, so that all see the same machine."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

# Recordings are simulated by the studies' packages.
sys.path.append(str(Path(__file__).resolve().parents[1] / "studies"))


@dataclass(frozen=True)
class TimingRow:
    """One line of the table: seconds a unit, median and quartiles over the rounds."""

    group: str
    name: str
    seconds: float | None
    low: float | None
    high: float | None
    error: float | None = None
    note: str = ""

    def line(self) -> str:
        """Write the row for the terminal."""
        if self.seconds is None:
            return f"{self.group:<14} {self.name:<44} {self.note}"
        error = "" if self.error is None else f"  max error/range {self.error:8.1e}"
        return (
            f"{self.group:<14} {self.name:<44} {1e3 * self.seconds:10.4f} ms  "
            f"[{1e3 * self.low:.4f}, {1e3 * self.high:.4f}]{error}  {self.note}"
        )


def missing(group: str, name: str, package: str) -> TimingRow:
    """Make the row of what could not be run for want of an optional package."""
    return TimingRow(group, name, None, None, None, None, f"{package} is not installed")


def ratio(slow: float | None, fast: float | None) -> float | None:
    """Return how many times faster; None where either was not measured."""
    return slow / fast if slow is not None and fast is not None else None


@dataclass(frozen=True)
class Goal:
    """A figure of the report that has to reach a number."""

    key: str
    text: str
    goal: float
    at_most: bool = False

    def line(self, report: Mapping[str, Any]) -> str:
        """Write the goal for the terminal: figure, goal, met or not."""
        value = report.get(self.key)
        goal = f"{'<=' if self.at_most else '>='} {self.goal:g}"
        if value is None:
            return f"{self.text:<66} {goal:>10} {'':>12}  not measured"
        met = value <= self.goal if self.at_most else value >= self.goal
        return f"{self.text:<66} {goal:>10} {value:>12.4g}  {'met' if met else 'NOT MET'}"


@dataclass(frozen=True)
class Route:
    """Something to time: ``call`` does ``units`` units of work."""

    group: str
    name: str
    call: Callable[[], Any]
    units: int = 1
    error: float | None = None
    note: str = ""


def time_routes(routes: list[Route], rounds: int) -> dict[str, TimingRow]:
    """Time the routes round by round after one call to warm up."""
    for route in routes:
        route.call()
    seconds: dict[str, list[float]] = {route.name: [] for route in routes}
    for _ in range(rounds):
        for route in routes:
            start = time.perf_counter()
            route.call()
            seconds[route.name].append((time.perf_counter() - start) / route.units)
    rows = {}
    for route in routes:
        low, middle, high = np.quantile(seconds[route.name], [0.25, 0.5, 0.75])
        rows[route.name] = TimingRow(route.group, route.name, middle, low, high, route.error, route.note)
        print(rows[route.name].line(), flush=True)
    return rows


def update(path: Path, keys: Mapping[str, Any], rows: list[TimingRow], groups: tuple[str, ...]) -> None:
    """Merge keys and rows into the JSON report; rows of `groups` replace earlier ones."""
    report: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    kept = [row for row in report.get("rows", []) if row.get("group") not in groups]
    report.update(keys)
    report["rows"] = kept + [asdict(row) for row in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(report, indent=1) + "\n")
    os.replace(partial, path)
