"""A small frame for side-by-side timings: every route runs once a round, so that all see the same machine."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Row:
    """One line of the table: seconds a unit, median and quartiles over the rounds."""

    group: str
    name: str
    seconds: float
    low: float
    high: float
    error: float | None = None
    note: str = ""

    def line(self) -> str:
        """For the terminal."""
        error = "" if self.error is None else f"  max error/range {self.error:8.1e}"
        return (
            f"{self.group:<14} {self.name:<44} {1e3 * self.seconds:10.4f} ms  "
            f"[{1e3 * self.low:.4f}, {1e3 * self.high:.4f}]{error}  {self.note}"
        )


@dataclass(frozen=True)
class Route:
    """Something to time: ``call`` does ``units`` units of work."""

    group: str
    name: str
    call: Callable[[], Any]
    units: int = 1
    error: float | None = None
    note: str = ""


def measure(routes: list[Route], rounds: int) -> dict[str, Row]:
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
        rows[route.name] = Row(route.group, route.name, middle, low, high, route.error, route.note)
        print(rows[route.name].line(), flush=True)
    return rows


def update(path: Path, keys: Mapping[str, float | None], rows: list[Row], groups: tuple[str, ...]) -> None:
    """Merge keys and rows into the JSON report; rows of `groups` replace earlier ones."""
    report: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    kept = [row for row in report.get("rows", []) if row.get("group") not in groups]
    report.update(keys)
    report["rows"] = kept + [asdict(row) for row in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(report, indent=1) + "\n")
    os.replace(partial, path)
