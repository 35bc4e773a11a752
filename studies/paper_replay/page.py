"""The replay as ``result.json`` holds it: the section of the page, and all numbers behind it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from aero_bayes.report import write_run_page
from aero_bayes.schema import SCHEMA, StudyColumnJson, StudyJson, StudyRowJson
from aero_bayes.workflow import versions, write_result, write_series
from paper_replay.result import Replay

#: Prefix of the curves in series.npz, and the key of the numbers in result.json.
NAME = "replay"


def write_run(replay: Replay, folder: Path) -> Path:
    """Write ``result.json``, ``series.npz`` and the page into a folder; return the page's path."""
    write_series(folder, replay.series)
    write_result(folder, run_result(replay))
    return write_run_page(folder)


def run_result(replay: Replay) -> dict[str, Any]:
    """Return the content of ``result.json``.

    ``study`` is what the page shows; ``replay`` holds the rows with all their errors.
    """
    best = min((row for row in replay.rows if row.fitness is not None), key=lambda row: float(row.fitness or 0.0))
    return {
        "schema": SCHEMA, "command": NAME, "seed": replay.seed, "versions": versions(), "data": [], "simulated": True,
        "study": study_section(replay).model_dump(),
        NAME: {"rows": [asdict(row) | {"model": row.label} for row in replay.rows]},
        "failures": dict(replay.failures),
        "seconds": replay.seconds,
        "verdict": {"level": "good", "text": f"Best of Table 1's models here: {best.label}, {best.fitness:.3g} rad²."},
    }  # fmt: skip


def study_section(replay: Replay) -> StudyJson:
    """Describe the section of the page: Fig. 6, Table 1 beside the paper's fitness, and the notes."""
    names = list(dict.fromkeys(name for row in replay.rows for name in row.parameters))
    columns = [
        *(StudyColumnJson(title=f"`{name}`") for name in names),
        StudyColumnJson(title="fitness, here", digits=4),
        StudyColumnJson(title="fitness, paper", digits=6),
    ]
    rows = []
    for row in replay.rows:
        values = [*(row.parameters.get(name) for name in names), row.fitness, row.paper_fitness]
        rows.append(StudyRowJson(label=row.label, note=row.note, values=values))
    return StudyJson(
        name=NAME, title="The paper, replayed", output="the paper's output (SI units)",
        figure_caption="The paper’s Fig. 6, redrawn from this run. A model that leaves the frame is cut off by it.",
        table_caption="Table 1 of the paper, replayed (SI units; fitness by Eq. 6, smaller is better)",
        columns=columns, rows=rows, smallest_in=len(names), notes=list(replay.notes),
    )  # fmt: skip
