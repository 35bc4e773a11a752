"""A figure of the page: drawings, alternative text and table, and the data of the script."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.report.drawing import Band, Line, Panel, draw
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import minus, tidy

WIDE_WIDTH, NARROW_WIDTH, SMALL_WIDTH = 1140.0, 350.0, 320.0
_STRETCHES = 12


@dataclass(frozen=True)
class Plate:
    """A figure: drawings for wide and narrow screens, its alternative text and table.

    Figures of one ``link`` zoom together; ``keys`` are the series that the script draws from."""

    wide: Markup
    narrow: Markup | None
    alt: str
    caption: Markup
    legend: tuple[tuple[str, str], ...] = ()
    table: Markup | None = None
    link: str = ""
    keys: frozenset[str] = frozenset()
    css: str = ""


def plate(
    panels: Sequence[Panel],
    alt: str,
    x_label: str,
    caption: Markup | str = "",
    *,
    legend: tuple[tuple[str, str], ...] = (),
    link: str = "",
    width: float = WIDE_WIDTH,
) -> Plate:
    """Make panels a figure. One as wide as the page is drawn a second time, for phones."""
    keys = frozenset(
        key for p in panels for layer in p.layers
        if layer.source for key in layer.source.keys
    )  # fmt: skip
    narrow = draw(panels, NARROW_WIDTH, alt, x_label) if width > 600 else None
    table = data_table(panels, x_label, alt)
    return Plate(draw(panels, width, alt, x_label), narrow, alt, Markup.escape(caption), legend, table, link, keys)


def data_table(panels: Sequence[Panel], x_label: str, alt: str) -> Markup | None:
    """Return the labelled layers of a figure as a table.

    Means over equal stretches of the x axis, RMS for residuals."""
    shown = [
        (panel, layer) for panel in panels for layer in panel.layers if isinstance(layer, Line | Band) and layer.label
    ]
    if not shown:
        return None
    given = next((panel.x_limits for panel in panels if panel.x_limits), None)
    low, high = given or (
        min(float(np.min(layer.x)) for _, layer in shown), max(float(np.max(layer.x)) for _, layer in shown)
    )  # fmt: skip
    edges = np.linspace(low, high, _STRETCHES + 1)
    heads = [Column(x_label)]
    for panel, layer in shown:
        words = f"{layer.label}, RMS" if isinstance(layer, Line) and layer.rms else layer.label
        heads.append(Column(f"{panel.title}: {words}", "right"))
    rows = [
        (f"{tidy(first)} … {tidy(last)}", *(_cell(layer, first, last) for _, layer in shown))
        for first, last in pairwise(edges.tolist())
    ]
    return html_table(heads, rows, alt)


def _cell(layer: Line | Band, first: float, last: float) -> str:
    within = (layer.x >= first) & (layer.x <= last)
    if isinstance(layer, Band):
        return f"{_mean(layer.low[within])} … {_mean(layer.high[within])}"
    values = layer.y[within]
    return _mean(values**2, root=True) if layer.rms else _mean(values)


def _mean(values: FloatArray, *, root: bool = False) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return "–"
    return minus(tidy(float(np.sqrt(known.mean()) if root else known.mean()), 4))
