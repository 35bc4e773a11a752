"""A study: tasks that are worked on one by one, rows that are kept, and their summary.

Rows stand in ``OUT/NAME/rows.jsonl``, one a line, and the last one of a key counts. A run that was stopped goes on
where it was.
"""

from __future__ import annotations

import json
import subprocess
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from aero_bayes.files import write_whole
from aero_bayes.parallel import Lost, results

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

    ``options`` has ``out``, ``trials`` (tasks that are looked at, from the first), ``minutes``, ``workers``, ``only``
    and ``again`` (patterns of keys), and what the study's own tasks ask for.
    """
    name = f"{study.name}-dev" if options.development else study.name
    path = options.out / name / "rows.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    tasks = study.tasks(options)
    rows = {row["key"]: row for row in map(json.loads, path.read_text("utf-8").splitlines())} if path.exists() else {}
    chosen = [key for key in tasks if matches([key], options.only or ["*"])][: options.trials]
    wanted = {key: tasks[key] for key in chosen if key not in rows or matches([key], options.again)}
    end = time.monotonic() + 60.0 * (study.minutes if options.minutes is None else options.minutes)
    with path.open("a", encoding="utf-8") as file, tqdm(total=len(wanted)) as bar:
        for row in worked(study.attempt, wanted, options.workers, end):
            file.write(json.dumps(row) + "\n")
            file.flush()
            rows[row["key"]] = row
            bar.update()
    made = [rows[key] for key in tasks if key in rows]
    codes = sorted({str(row["code"]) for row in made})
    summary = {**study.summary(made), "left": len(tasks) - len(made), "code": codes}
    write_json(summary, options.out / f"{name}.json")
    return summary


def worked(attempt: Callable[[Any], Row], tasks: Tasks, workers: int, end: float) -> Iterator[Row]:
    """Yield the row of each task as it comes, and begin none after ``end``; with no workers, in this process.

    A task whose process dies takes no other one with it, and its row says so.
    """
    if not workers:
        yield from (row_of(attempt, one) for one in tasks.items() if time.monotonic() < end)
        return
    with closing(
        results(partial(row_of, attempt), tasks.items(), workers, late=lambda: time.monotonic() >= end)
    ) as rows:
        for (key, _), row in rows:
            died = {"key": key, "error": "its process died", "seconds": 0.0, "code": code()}
            yield died if isinstance(row, Lost) else row


def row_of(attempt: Callable[[Any], Row], one: tuple[str, Any]) -> Row:
    """Make the row of a key and its task; what is raised becomes a row with ``error``."""
    key, task = one
    began = time.perf_counter()
    try:
        row = attempt(task)
    except Exception as error:
        row = {"error": " ".join(f"{type(error).__name__}: {error}".split())}
    return {"seconds": round(time.perf_counter() - began, 2), **row, "key": key, "code": code()}


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
