"""Tasks for the runner's tests: importable by worker processes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.commands.fleet_runner import Row, read_rows, work_on


@dataclass(frozen=True)
class Count:
    """A task whose number decides what becomes of it; ``marks`` is a folder where it leaves word."""

    number: int
    marks: Path
    seconds: float = 0.0


def plain(task: Count) -> dict[str, Any]:
    """A row that depends on the task alone; every seventh fails."""
    time.sleep(task.seconds)
    if task.number % 7 == 6:
        raise ValueError("this one\ncannot be")
    return {"value": float(np.random.default_rng(task.number).normal())}


def work(task: Count) -> dict[str, Any]:
    """The same, but every fifth kills its worker the first time."""
    mark = task.marks / str(task.number)
    first = not mark.exists()
    mark.touch()
    if task.number % 5 == 3 and first:
        os._exit(9)
    return plain(task)


def one_always_dies(task: Count) -> dict[str, Any]:
    """The first of these tasks nobody survives."""
    if task.number == 1:
        os._exit(9)
    return plain(task)


def mark_and_sleep(task: Count) -> dict[str, Any]:
    """Leave word of the worker's process, and stay."""
    (task.marks / str(os.getpid())).touch()
    time.sleep(60.0)
    return {}


def rows_of(folder: Path, work: Callable[[Count], Row], count: int, seconds: float = 0.0, **how: Any) -> list[Row]:
    """Rows of so many tasks, in a file of the folder."""
    tasks = {f"{k:04}": Count(k, folder / "marks", seconds) for k in range(count)}
    known = read_rows(folder / "rows.jsonl")
    wanted = {key: task for key, task in tasks.items() if key not in known}
    (folder / "marks").mkdir(parents=True, exist_ok=True)
    for _ in work_on(wanted.items(), work, folder / "rows.jsonl", lambda key: {}, **how):
        pass
    return [row for _, row in sorted(read_rows(folder / "rows.jsonl").items())]


def killed_with_a_pool(folder: str) -> None:
    """What a caller of a pool does that the test kills."""
    rows_of(Path(folder), mark_and_sleep, 4, workers=2)


def killed_half_way(folder: str) -> None:
    """What a caller does that the test kills."""
    rows_of(Path(folder), plain, 60, 0.02, workers=1)
