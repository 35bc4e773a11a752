"""A study: tasks that are worked on one by one, rows that are kept, and their summary.

Rows stand in ``OUT/NAME/rows.jsonl``, one a line, and the last one of a key counts. A run that was stopped goes on
where it was.
"""

from __future__ import annotations

import json
import subprocess
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from aero_bayes.commands.fleet_runner import read_rows, work_on
from aero_bayes.files import write_whole

Row = dict[str, Any]
#: Tasks by keys that no two share; a task can be pickled.
Tasks = Mapping[str, Any]
#: What is said of a study in words, and the cells of its table.
Told = tuple[str, list[tuple[object, ...]]]


@dataclass(frozen=True)
class Study:
    """What is done, and how it is told on the page of results.

    ``table`` makes of the summary of the rows what is said of it and the cells below ``head``. ``minutes`` is how long
    a run goes on beginning tasks where nothing else is said.
    """

    name: str
    about: str
    tasks: Callable[[Namespace], Tasks]
    attempt: Callable[[Any], Row]
    summary: Callable[[Sequence[Row]], Row]
    table: Callable[[Mapping[str, Any]], Told]
    head: Sequence[str] = ("", "goal", "measured", "trials")
    minutes: float = float("inf")


def run(study: Study, options: Namespace) -> Row:
    """Work on the tasks that have no row yet, then summarise all rows and write the summary.

    ``options`` has ``out``, ``minutes``, ``workers``, ``only`` (patterns of keys), and what the study's own tasks ask
    for.
    """
    path, tasks = options.out / study.name / "rows.jsonl", study.tasks(options)
    rows = read_rows(path)
    wanted = {key: task for key, task in tasks.items() if key not in rows and matches([key], options.only or ["*"])}
    end = time.monotonic() + 60.0 * (study.minutes if options.minutes is None else options.minutes)

    def more(key: str) -> Row:
        return {"code": code()}

    for row in tqdm(
        work_on(
            wanted.items(), study.attempt, path, more, workers=options.workers, late=lambda: time.monotonic() >= end
        ),
        total=len(wanted),
    ):
        rows[row["key"]] = row
    made = [rows[key] for key in tasks if key in rows]
    codes = sorted({str(row["code"]) for row in made})
    summary = {**study.summary(made), "left": len(tasks) - len(made), "code": codes}
    write_json(summary, options.out / f"{study.name}.json")
    return summary


@cache
def code() -> str:
    """Return the commit that is run, with a mark where files differ from it."""
    command = ["git", "describe", "--always", "--dirty"]
    here = Path(__file__).parent
    return subprocess.run(command, cwd=here, capture_output=True, text=True, check=False).stdout.strip()


def write_json(summary: Mapping[str, Any], path: Path) -> None:
    """Write a summary whole or not at all."""
    write_whole(path, json.dumps(summary, indent=1) + "\n")


def keyed(tasks: Iterable[tuple[Any, ...]]) -> dict[str, tuple[Any, ...]]:
    """Give each task its parts, joined, as a key."""
    return {"/".join(map(str, task)): task for task in tasks}


def matches(names: Iterable[str], patterns: Iterable[str]) -> bool:
    """Whether one of the names matches one of the patterns."""
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)


def rate(rows: Sequence[Row], test: Callable[[Row], Any]) -> float | None:
    """Return the share of rows that pass; None where there is none."""
    return sum(bool(test(row)) for row in rows) / len(rows) if rows else None


def quantile(values: Sequence[float], q: float) -> float | None:
    """Return a quantile; None of nothing."""
    return float(np.quantile(values, q)) if values else None


def percent(share: float | None, count: int = 0) -> str:
    """Write a share in per cent, with the standard error that so many trials leave; none and all leave one, too."""
    if share is None:
        return "-"
    smooth = (share * count + 1) / (count + 2)
    error = f" (± {100 * (smooth * (1 - smooth) / count) ** 0.5:.0f})" if count else ""
    return f"{100 * share:.0f} %{error}"


def number(value: float | None) -> str:
    """Write a number with three digits."""
    return "-" if value is None else f"{value:.3g}"


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Write the lines of a table in Markdown."""
    return [f"| {' | '.join(map(str, cells))} |" for cells in (head, ["---"] * len(head), *rows)]


def rate_of(what: str, goal: str, rows: Sequence[Row], test: Callable[[Row], Any]) -> Row:
    """Return a line of a table: the share of rows that pass, its goal, and of how many it is."""
    return {"what": what, "goal": goal, "share": rate(rows, test), "trials": len(rows)}


def rate_cells(rates: Iterable[Mapping[str, Any]]) -> list[tuple[object, ...]]:
    """Write the cells of such lines."""
    return [(one["what"], one["goal"], percent(one["share"], one["trials"]), one["trials"]) for one in rates]
