"""The paper's Table 1 and Fig. 6, replayed."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from aero_bayes.report.curves import largest
from aero_bayes.report.drawing import FloatArray, Line, Panel, Source
from aero_bayes.report.figure import Plate, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.svg import MEASURED, SERIES
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import significant, symbol, tidy
from aero_bayes.schema import ReplayJson

_TIME = "replay/time"


def replay_plate(run: RunDirectory) -> Plate | None:
    """The paper's Fig. 6: the measured output and that of every model of Table 1."""
    found = {key.removeprefix("replay/"): run.series[key] for key in run.series if key.startswith("replay/")}
    time, measured = found.pop("time", None), found.pop("measured", None)
    models = {name: values for name, values in found.items() if time is not None and values.shape == time.shape}
    if time is None or len(time) < 2 or not (models or measured is not None):
        return None
    lines = [
        Line(time, v, SERIES[i % len(SERIES)], label=name, source=Source(_TIME, ((1, f"replay/{name}"),)))
        for i, (name, v) in enumerate(models.items())
    ]
    if measured is not None:
        source = Source(_TIME, ((1, "replay/measured"),))
        lines.insert(0, Line(time, measured, MEASURED, 3.0, label="measured", source=source))
    panel = Panel("the paper's output (SI units)", tuple(lines), 270, ticks=6, y_limits=_readable(models, measured))
    alt = "The paper's output over time, measured and as given by " + ", ".join(models) + "."
    legend = ((MEASURED, "measured"), *((SERIES[i % len(SERIES)], name) for i, name in enumerate(models)))
    words = "The paper’s Fig. 6, redrawn from this run. A model that leaves the frame is cut off by it."
    return plate([panel], alt, "time (s)", words, legend=legend, link="replay")


def _readable(models: dict[str, FloatArray], measured: FloatArray | None) -> tuple[float, float] | None:
    """Limits about the measurement where a model leaves it by far, so that one wild curve does not flatten the rest."""
    if measured is None or not np.isfinite(measured).any():
        return None
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    reach = max((largest(values) for values in models.values()), default=0.0)
    span = high - low
    return (low - 1.2 * span, high + 1.2 * span) if reach > 4 * max(abs(low), abs(high)) > 0 else None


def replay_table(found: ReplayJson) -> Markup | None:
    """Table 1 of the paper: every model's parameters and fitness, beside the paper's fitness."""
    if not found.rows:
        return None
    names = list(dict.fromkeys(name for row in found.rows for name in row.parameters))
    best = min((row.fitness for row in found.rows if row.fitness is not None), default=None)
    rows = [
        (
            Markup("{}<small>{}</small>").format(row.model, row.note),
            *(significant(row.parameters.get(name), 3) for name in names),
            significant(row.fitness, 4), tidy(row.paper_fitness, 6),
        )
        for row in found.rows
    ]  # fmt: skip
    fits = Column("fitness, here", "right"), Column("fitness, paper", "right")
    columns: tuple[Column | str, ...] = ("model", *(Column(symbol(name), "right") for name in names), *fits)
    marked = [index for index, row in enumerate(found.rows) if row.fitness is not None and row.fitness == best]
    return html_table(
        columns, rows, "Table 1 of the paper, replayed (SI units; fitness by Eq. 6, smaller is better)", marked
    )
