"""Tasks for the runner's tests: importable by worker processes."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.commands.fleet_runner import Table, run_tasks


@dataclass(frozen=True)
class Count:
    """A task whose number decides what becomes of it; ``marks`` is a folder where it leaves word."""

    number: int
    marks: Path
    seconds: float = 0.0

    made_of: str = ""

    @property
    def key(self) -> str:
        return f"{self.number:04}"


def plain(task: Count) -> dict[str, Any]:
    """A row that depends on the task alone; every seventh fails."""
    time.sleep(task.seconds)
    if task.number % 7 == 6:
        raise ValueError("this one\ncannot be")
    return {"key": task.key, "value": float(np.random.default_rng(task.number).normal())}


def work(task: Count) -> dict[str, Any]:
    """The same, but every fifth kills its worker the first time."""
    mark = task.marks / task.key
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
    return {"key": task.key}


def killed_with_a_pool(folder: str) -> None:
    """What a caller of a pool does that the test kills."""
    with Table(Path(folder) / "rows.sqlite") as rows:
        run_tasks([Count(k, Path(folder) / "marks") for k in range(4)], mark_and_sleep, rows, workers=2)


def killed_half_way(folder: str) -> None:
    """What a caller does that the test kills."""
    with Table(Path(folder) / "rows.sqlite") as rows:
        run_tasks([Count(k, Path(folder) / "marks", 0.02) for k in range(60)], plain, rows, workers=1)
