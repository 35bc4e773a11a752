"""What blind trials share: a pool whose finished rows are kept, rates, and how they are shown."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from tqdm import tqdm

Row = dict[str, Any]
#: Distances between which rates are given.
BANDS = ((0.0, 4.0), (4.0, 8.0), (8.0, 12.0), (12.0, 20.0), (20.0, 50.0), (50.0, 200.0), (200.0, float("inf")))


class Keyed(Protocol):
    """A trial that its key tells from all others."""

    @property
    def key(self) -> str: ...


Task = TypeVar("Task", bound=Keyed)


def run_all(tasks: Sequence[Task], attempt: Callable[[Task], Row], lines: Path, processes: int) -> list[Row]:
    """Rows of all tasks, in their order; those that ``lines`` holds already are not run again.

    ``attempt`` returns a row with the task's key under ``key`` and never raises. Every row is written to ``lines``
    (JSON, one a line) as soon as it is there.
    """
    done: dict[str, Row] = {}
    if lines.exists():
        for line in lines.read_text(encoding="utf-8").splitlines():
            if line.endswith("}"):  # The last one may have been cut off.
                row = json.loads(line)
                done[row["key"]] = row
    lines.parent.mkdir(parents=True, exist_ok=True)
    wanted = [task for task in tasks if task.key not in done]
    with lines.open("a", encoding="utf-8") as stream, tqdm(total=len(tasks), initial=len(tasks) - len(wanted)) as bar:
        for row in _outcomes(wanted, attempt, processes):
            stream.write(json.dumps(row) + "\n")
            stream.flush()
            done[row["key"]] = row
            bar.update()
    return [done[task.key] for task in tasks if task.key in done]


def _outcomes(tasks: Sequence[Task], attempt: Callable[[Task], Row], processes: int) -> Iterator[Row]:
    """Rows as they are finished."""
    if processes <= 1:
        yield from map(attempt, tasks)
        return
    with multiprocessing.get_context("spawn").Pool(processes, maxtasksperchild=50) as pool:
        yield from pool.imap_unordered(attempt, tasks)


def write_summary(summary: dict[str, Any], path: Path) -> None:
    """Write a summary whole or not at all."""
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    temporary.replace(path)


def rate(rows: Sequence[Row], test: Callable[[Row], bool]) -> float | None:
    """Share of rows that pass; None where there is none."""
    return sum(map(test, rows)) / len(rows) if rows else None


def quantile(values: Sequence[float], q: float) -> float | None:
    """A quantile; None of nothing."""
    return float(np.quantile(values, q)) if values else None


def show(value: float | None, percent: bool = True) -> str:
    """A share or a number for a table."""
    return "-" if value is None else f"{100 * value:.1f} %" if percent else f"{value:.3g}"
