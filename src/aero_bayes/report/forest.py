"""Values and 90 % intervals of parameters, each row on a scale of its own: before and after, or run by run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from aero_bayes.report.drawing import NARROW_WIDTH, WIDE_WIDTH, Plate
from aero_bayes.report.schema_estimate import QuantilesJson
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.svg import ACCENT, INK, MUTED, RULE, WARM_COLOUR, Canvas
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import NO_VALUE, greek_name, signed, significant, symbol
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH

#: By parameter what is drawn of each series, in the order of the colours; None where a series has no such parameter.
Rows = Mapping[str, Sequence[QuantilesJson | None]]
_LINE, _GAP, _LETTERS = 11.0, 16.0, 48


def forest_plate(rows: Rows, colours: Sequence[str], alt: str, legend: tuple[tuple[str, str], ...] = (),
                 table: Markup | None = None) -> Plate | None:  # fmt: skip
    """Draw the rows in which anything has an interval; None where none has."""
    drawn = {name: own for name, own in rows.items() if any(q is not None and q.q05 is not None for q in own)}
    if not drawn:
        return None
    wide, narrow = (_drawing(drawn, colours, width, alt) for width in (WIDE_WIDTH, NARROW_WIDTH))
    caption = Markup("90 % intervals. Each row has its own scale.")
    return Plate(wide, narrow, alt, caption, legend, table)


def _drawing(rows: Rows, colours: Sequence[str], width: float, alt: str) -> Markup:
    words = {name: next((q.description for q in own if q and q.description), "") for name, own in rows.items()}
    label = 82.0 if width < 600 else 340.0 if any(words.values()) else 150.0
    tall = _LINE * len(colours) + _GAP
    canvas = Canvas(width, tall * len(rows) + 8, alt)
    for index, (name, own) in enumerate(rows.items()):
        top = 8 + tall * index
        ends = [end for q in own if q is not None for end in (q.q05, q.q95, q.value) if end is not None]
        low, spread = min(ends), (max(ends) - min(ends)) or abs(max(ends)) or 1.0
        canvas.text(0, top + 0.5 * _LINE * len(colours) + 4, greek_name(name), INK, 12)
        if width > 600:
            canvas.text(76, top + 0.5 * _LINE * len(colours) + 4, words[name][:_LETTERS], MUTED, 10.5)
        canvas.curve([0, width], [top + _LINE * len(colours) + 6] * 2, RULE, 0.7)
        for k, found in enumerate(own):
            if found is None or found.value is None:
                continue
            y = top + _LINE * (k + 0.5)
            scale = (width - label - 20) / spread
            first, middle, last = (
                label + 10 + scale * ((found.value if x is None else x) - low)
                for x in (found.q05, found.value, found.q95)
            )
            canvas.curve([first, last], [y, y], colours[k], 3.0)
            canvas.dots(np.array([middle]), np.array([y]), colours[k], 7.0, 1.0)
            canvas.curve([middle, middle], [y - 4, y + 4], MUTED, 0.8)
    return canvas.svg()


def before_and_after(result: RunJson) -> Plate | None:
    """Draw parameters before and after the model was extended, and list how far each moved; None for another run."""
    loop = result.loop
    if loop is None or not loop.effects:
        return None
    rows: dict[str, list[QuantilesJson | None]] = {}
    moves = []
    for name, moved in loop.shifts.items():
        stated = result.parameters.get(name)
        was = _spread(moved.before, moved.before_sd, stated.unit if stated else "")
        now = stated if stated is not None else _spread(moved.after, moved.after_sd, "")
        rows[name] = [was, now]
        share = (
            100 * (moved.after - moved.before) / abs(moved.before) if moved.before and moved.after is not None else None
        )
        moves.append((symbol(name), stated.description if stated else "", NO_VALUE if share is None else
                      f"{signed(share, 1)}\u00a0%", significant(moved.in_sd, 2)))  # fmt: skip
    columns = ("parameter", "", Column("change", "right"), Column("in combined standard deviations", "right"))
    table = html_table(columns, moves, "How far the parameters moved") if moves else None
    legend = ((WARM_COLOUR, "before"), (ACCENT, "after"))
    alt = f"Values and 90 % intervals of {', '.join(rows)} before and after the model was extended."
    return forest_plate(rows, (WARM_COLOUR, ACCENT), alt, legend, table)


def _spread(value: float | None, sd: float | None, unit: str) -> QuantilesJson:
    if value is None or sd is None:
        return QuantilesJson(value=value, unit=unit)
    return QuantilesJson(value=value, q05=value - NORMAL_HALF_WIDTH * sd, q95=value + NORMAL_HALF_WIDTH * sd, unit=unit)
