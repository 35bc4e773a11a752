"""The section of a study: curves of one output over time, and a table."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.report.curves import largest
from aero_bayes.report.drawing import Line, Panel, Plate, Source, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_loop import StudyJson
from aero_bayes.report.svg import MEASURED, SERIES
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import sentence, tidy


def study_plate(run: RunDirectory, study: StudyJson) -> Plate | None:
    """Draw the measured output and that of every model of the study over time; None where no curve is there."""
    prefix = f"{study.name}/"
    found = {key.removeprefix(prefix): values for key, values in run.series.items() if key.startswith(prefix)}
    time, measured = found.pop("time", None), found.pop("measured", None)
    models = {name: values for name, values in found.items() if time is not None and values.shape == time.shape}
    if time is None or len(time) < 2 or not (models or measured is not None):
        return None

    def source(name: str) -> Source:
        return Source(f"{prefix}time", ((1, f"{prefix}{name}"),))

    lines = [
        Line(time, values, SERIES[i % len(SERIES)], label=name, source=source(name))
        for i, (name, values) in enumerate(models.items())
    ]
    if measured is not None:
        lines.insert(0, Line(time, measured, MEASURED, 3.0, label="measured", source=source("measured")))
    panel = Panel(study.output, tuple(lines), 270, ticks=6, y_limits=_readable(models, measured))
    alt = f"{study.output} over time, measured and as given by {', '.join(models)}."
    legend = ((MEASURED, "measured"), *((SERIES[i % len(SERIES)], name) for i, name in enumerate(models)))
    return plate([panel], alt, "time (s)", study.figure_caption, legend=legend, link=study.name)


def _readable(models: dict[str, FloatArray], measured: FloatArray | None) -> tuple[float, float] | None:
    """Limit the axis about the measurement, so that a curve that is far off does not flatten the rest."""
    if measured is None or not np.isfinite(measured).any():
        return None
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    reach = max((largest(values) for values in models.values()), default=0.0)
    span = high - low
    return (low - 1.2 * span, high + 1.2 * span) if reach > 4 * max(abs(low), abs(high)) > 0 else None


def study_table(study: StudyJson) -> Markup | None:
    """Write the table of a study; None where it has no rows."""
    if not study.rows:
        return None
    rows = [
        (
            Markup("{}<small>{}</small>").format(row.label, row.note),
            *(tidy(value, column.digits) for value, column in zip(row.values, study.columns, strict=True)),
        )
        for row in study.rows
    ]
    columns: tuple[Column | str, ...] = ("model", *(Column(sentence(c.title), "right") for c in study.columns))
    return html_table(columns, rows, study.table_caption, _smallest(study))


def _smallest(study: StudyJson) -> list[int]:
    """Return rows whose number in the column ``smallest_in`` is the smallest."""
    if study.smallest_in is None:
        return []
    numbers = [row.values[study.smallest_in] for row in study.rows]
    best = min((number for number in numbers if number is not None), default=None)
    return [index for index, number in enumerate(numbers) if number is not None and number == best]
