"""What studies share: their options, the runner whose finished rows are kept, rates, and how they are shown."""

from __future__ import annotations

import json
import subprocess
import time
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from tqdm import tqdm

from aero_bayes.fleets import Row, Table, Task, open_executor, run_tasks

#: Distances between which rates are given.
BANDS = ((0.0, 4.0), (4.0, 8.0), (8.0, 12.0), (12.0, 20.0), (20.0, 50.0), (50.0, 200.0), (200.0, float("inf")))


def run_trials(
    tasks: Sequence[Task],
    attempt: Callable[[Task], Row],
    path: Path,
    executor: Executor | None = None,
    *,
    made_of: str = "",
    until: Callable[[], bool] = lambda: False,
) -> list[Row]:
    """Run all tasks that the table does not hold yet, on the runner of fleets, and return all rows in order."""
    with Table(path) as table, tqdm(total=len(tasks)) as bar:
        run_tasks(tasks, attempt, table, executor, made_of=lambda task: made_of, until=until, progress=bar.update)
        found = {task.key: table.get(task.key) for task in tasks}
    return [row for row in found.values() if row is not None]


def executor_options(parser: ArgumentParser) -> None:
    """Add the options that say where trials run: processes here, or a Dask scheduler's workers."""
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--dask", help="address of a scheduler, its file, or local")


def study_parser(description: str | None, stop_after: float = float("inf")) -> ArgumentParser:
    """Make a parser with the options that every study has.

    ``stop_after`` is the default of the option of this name, in minutes from now.
    """
    parser = ArgumentParser(description=description, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("reports"), help="folder of the summary and of finished rows")
    parser.add_argument("--stop-after", type=float, default=stop_after, help="start nothing after so many minutes")
    parser.set_defaults(began=time.monotonic())
    executor_options(parser)
    return parser


def trial_parser(
    description: str | None, kinds: Sequence[str] = (), stop_after: float = float("inf")
) -> ArgumentParser:
    """Make a parser of a study with seeds for development, and with a choice of ``kinds`` of trials where given."""
    parser = study_parser(description, stop_after)
    parser.add_argument("--development", action="store_true", help="the seeds that methods may be tuned on")
    if kinds:
        parser.add_argument("--quick", action="store_true", help="a small fixed part")
        parser.add_argument("--only", choices=kinds, help="one kind of trial")
        parser.add_argument("--count", type=int, help="trials of this kind, with --only")
    return parser


def trial_counts(options: Namespace, full: Mapping[str, int], quick: Mapping[str, int]) -> dict[str, int]:
    """Return how many trials of each kind the options of :func:`trial_parser` ask for."""
    counts = dict(quick if options.quick else full)
    return {options.only: options.count or counts.get(options.only, 1)} if options.only else counts


def run_study(
    tasks: Sequence[Task], attempt: Callable[[Task], Row], path: Path, options: Namespace, *, made_of: str = ""
) -> list[Row]:
    """Run :func:`run_trials` as the options of :func:`study_parser` say."""
    end = options.began + 60.0 * options.stop_after
    with open_executor(options.dask, options.processes) as executor:
        return run_trials(tasks, attempt, path, executor, made_of=made_of, until=lambda: bool(time.monotonic() >= end))


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Write the lines of a table in Markdown."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


def write_summary(summary: dict[str, Any], path: Path) -> None:
    """Write a summary whole or not at all."""
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    temporary.replace(path)


def code() -> str:
    """Return the commit that is run, with a mark where files differ from it."""
    here = Path(__file__).resolve().parent
    command = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(command, cwd=here, capture_output=True, text=True, check=False).stdout.strip()


def rate(rows: Sequence[Row], test: Callable[[Row], bool]) -> float | None:
    """Return the share of rows that pass; None where there is none."""
    return sum(map(test, rows)) / len(rows) if rows else None


def rates_by_band(rows: Sequence[Row], tests: Mapping[str, Callable[[Row], bool]]) -> list[dict[str, Any]]:
    """Return the rates of trials by the distance of their first effect, for each of :data:`BANDS`."""
    bands = [(low, high, [row for row in rows if low <= row["d"][0] < high]) for low, high in BANDS]
    return [
        {
            "d": [low, high if np.isfinite(high) else None],
            "trials": len(inside),
            **{name: rate(inside, test) for name, test in tests.items()},
            "found_something": rate(inside, lambda row: bool(row["found"])),
        }
        for low, high, inside in bands
    ]


def answer(row: Row) -> str:
    """Say how far a trial's first effect shows, and what was found in its place."""
    return f"(d = {row['d'][0]:.1f}) -> {', '.join(one['id'] for one in row['found']) or row['outcome']}"


def as_text(summary: Mapping[str, Any], notes: Sequence[str] = ()) -> str:
    """Write a summary for the terminal: its numbers by name, its tables (lists and mappings of rows), then notes.

    What stands under ``table`` are single trials, which nobody reads there.
    """
    lines: list[str] = []
    tables: list[str] = []

    def add(name: str, entry: Any) -> None:
        rows = entry if isinstance(entry, list) else list(entry.values()) if isinstance(entry, Mapping) else []
        if rows and all(isinstance(row, Mapping) for row in rows):
            index = None if isinstance(entry, list) else list(entry)
            frame = pandas.DataFrame(rows, index=index).round(3)
            tables.extend(["", f"{name}:", frame.to_string(index=index is not None, na_rep="-")])
        elif isinstance(entry, Mapping):
            for key, value in entry.items():
                add(f"{name}, {key}", value)
        else:
            lines.append(f"{name}: {'-' if entry is None else f'{entry:.3g}' if isinstance(entry, float) else entry}")

    for name, entry in summary.items():
        if name != "table":
            add(name.replace("_", " "), entry)
    return "\n".join([*lines, *tables, *(["", *notes] if notes else ())])


def quantile(values: Sequence[float], q: float) -> float | None:
    """Return a quantile; None of nothing."""
    return float(np.quantile(values, q)) if values else None


def cell(value: float | None, percent: bool = True) -> str:
    """Write a share or a number for a table."""
    return "-" if value is None else f"{100 * value:.1f} %" if percent else f"{value:.3g}"
