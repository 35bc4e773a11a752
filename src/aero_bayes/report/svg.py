"""Inline SVG that takes its colours from the page's CSS variables, so that one drawing serves light, dark and print."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike, NDArray

from aero_bayes.arrays import FloatArray

INK, MUTED, RULE, MEASURED, ACCENT, WARM_COLOUR = "ink", "muted", "rule", "measured", "accent", "warm"
SERIES = tuple(f"s{number}" for number in range(1, 7))


#: Width of what is stretched to the width of a figure.
WIDTH = 1000.0


class Canvas:
    """A drawing under construction, in CSS pixels from the top left corner.

    Colours are names of the page's CSS variables; coordinates are rounded to a tenth of a pixel. With ``left``, room
    for an axis, the drawing takes the width that it finds: texts and rules have places in per cent of it, and
    what stands in a ``window`` is stretched."""

    def __init__(self, width: float, height: float, alt: str, left: float | None = None) -> None:
        self._size = width, height
        self.alt, self._left = alt, left
        self._parts: list[Markup] = []
        self._open: list[str] = []

    def curve(
        self, x: ArrayLike, y: ArrayLike, colour: str, width: float = 1.0, dashes: str = "",
        data: Mapping[str, object] | None = None,
    ) -> None:  # fmt: skip
        """Draw a polyline; NaN values break it. ``data`` is what the page's script needs to draw it anew."""
        style = f"fill:none;stroke:var(--{colour});stroke-width:{width:g}"
        style += f";stroke-dasharray:{dashes}" if dashes else ""
        self._path(_polyline(np.asarray(x, float), np.asarray(y, float)), style, data)

    def area(
        self, x: FloatArray, low: FloatArray, high: FloatArray, colour: str, opacity: float, edge: float,
        data: Mapping[str, object] | None = None,
    ) -> None:  # fmt: skip
        """Fill the area between two curves, one piece between gaps (NaN)."""
        style = f"fill:var(--{colour});fill-opacity:{opacity:g}"
        if edge > 0:
            style += f";stroke:var(--{colour});stroke-opacity:{opacity:g};stroke-width:{edge:g}"
        whole = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        pieces = np.split(np.arange(len(x)), np.flatnonzero(np.diff(whole)) + 1)
        outline = "".join(
            _polyline(np.concatenate([x[p], x[p][::-1]]), np.concatenate([high[p], low[p][::-1]])) + "Z"
            for p in pieces
            if len(p) and whole[p[0]]
        )
        self._path(outline, style, data)

    def regions(self, rings: list[FloatArray], colour: str, opacity: float) -> None:
        """Fill closed rings, each of shape (n, 2); a ring within another is a hole."""
        outline = "".join(_polyline(ring[:, 0], ring[:, 1]) + "Z" for ring in rings)
        self._path(outline, f"fill:var(--{colour});fill-opacity:{opacity:g};fill-rule:evenodd")

    def dots(
        self, x: FloatArray, y: FloatArray, colour: str, size: float, opacity: float,
        data: Mapping[str, object] | None = None,
    ) -> None:  # fmt: skip
        """Round points."""
        marks = "".join(f"M{a} {b}h0" for a, b in zip(_rounded(x), _rounded(y), strict=True))
        style = (
            f"fill:none;stroke:var(--{colour});stroke-opacity:{opacity:g};stroke-width:{size:g};stroke-linecap:round"
        )
        self._path(marks, style, data)

    def text(
        self, x: float | str, y: float, words: str, colour: str = MUTED, size: float = 11.5, anchor: str = "start"
    ) -> None:
        """Write words on the base line at (x, y); R_a is set with a subscript. ``anchor``: start, middle or end."""
        where = Markup('<text x="{}" y="{:.1f}" font-size="{:.3g}" text-anchor="{}" style="fill:var(--{})">{}</text>')
        self._parts.append(where.format(_place(x), y, size, anchor, colour, _subscripts(words)))

    def tick(self, x: float | str, y: float, words: str, anchor: str) -> None:
        """Write a value beside an axis."""
        where = Markup('<text class="tick" x="{}" y="{:.1f}" text-anchor="{}">{}</text>')
        self._parts.append(where.format(_place(x), y, anchor, words))

    def rule(self, y: float, css_class: str) -> None:
        """Draw a line from side to side."""
        self._parts.append(Markup('<line class="{0}" x2="100%" y1="{1:.1f}" y2="{1:.1f}"/>').format(css_class, y))

    def notch(self, x: str, y: float) -> None:
        """Mark a value on the x axis."""
        mark = Markup('<line class="base" x1="{0}" x2="{0}" y1="{1:.1f}" y2="{2:.1f}"/>')
        self._parts.append(mark.format(x, y, y + 3))

    def outline(self, points: NDArray[np.complex128], style: str, *, closed: bool = True) -> None:
        """Draw straight from point to point, complex numbers, with a style."""
        self._path(_polyline(points.real, points.imag) + "Z" * closed, style)

    def group(self, css_class: str, data: Mapping[str, object] | None = None) -> None:
        """Begin a group, to which belongs what is drawn from here to ``end``."""
        self._begin("g", Markup('<g class="{}"{}>').format(css_class, _attribute(data)))

    def window(self, top: float, height: float, *, cut: bool) -> None:
        """Begin what is stretched from side to side, ``WIDTH`` wide for itself, to ``end``; ``cut`` hides the rest."""
        box = Markup('<svg y="{0:g}" height="{1:g}" viewBox="0 0 {2:g} {1:g}" preserveAspectRatio="none"{3}>')
        self._begin("svg", box.format(top, height, WIDTH, "" if cut else Markup(' overflow="visible"')))

    def end(self) -> None:
        """End what ``group`` or ``window`` began."""
        self._parts.append(Markup("</{}>").format(self._open.pop()))

    def svg(self) -> Markup:
        """Write the drawing as an ``<svg>`` element with its alternative text."""
        width, height = (f"{round(side, 1):g}" for side in self._size)
        size = Markup('viewBox="0 0 {} {}" style="max-width:{}px"').format(width, height, width)
        if self._left is not None:
            size = Markup('style="--left:{:.0f}px;height:{}px"').format(self._left, height)
        kind = "plot" if self._left is None else "plot fluid"
        frame = Markup('<svg class="{}" {} role="img" aria-label="{}">{}</svg>')
        return frame.format(kind, size, self.alt, Markup("").join(self._parts))

    def placed(self, top: float, axes: float) -> tuple[Markup, float, float]:
        """Write the drawing as part of a larger one, ``top`` from its upper edge, with width and height of that part.

        The axes are ``axes`` wide where the drawing takes the width that it finds."""
        (width, height), left = self._size, self._left or 0.0
        box = Markup('viewBox="0 0 {:g} {:g}"').format(width, height)
        if self._left is not None:
            width, box = axes, Markup('overflow="visible"')
        frame = Markup(
            '<svg class="plot" x="{:g}" y="{:g}" width="{:g}" height="{:g}" {} role="img" aria-label="{}">{}</svg>'
        )
        drawing = frame.format(left, top, width, height, box, self.alt, Markup("").join(self._parts))
        return drawing, width + left + (14.0 if left else 0.0), height

    def _begin(self, element: str, start: Markup) -> None:
        self._open.append(element)
        self._parts.append(start)

    def _path(self, outline: str, style: str, data: Mapping[str, object] | None = None) -> None:
        if outline or data:
            self._parts.append(Markup('<path d="{}" style="{}"{}/>').format(outline, style, _attribute(data)))


def _attribute(data: Mapping[str, object] | None) -> Markup:
    if data is None:
        return Markup("")
    return Markup(' data-spec="{}"').format(json.dumps(data, ensure_ascii=False, separators=(",", ":")))


def _place(x: float | str) -> str:
    return x if isinstance(x, str) else f"{x:.1f}"


def _rounded(values: FloatArray) -> list[str]:
    return [f"{value:g}" for value in np.round(values, 1).tolist()]


def _polyline(x: FloatArray, y: FloatArray) -> str:
    """Write the path data of every piece between gaps: its first point, then steps, in tenths of a pixel.

    Points that change nothing are left out."""
    points = np.asarray(np.round(np.column_stack([x, y]), 1), dtype=np.float64)
    known = np.isfinite(points).all(axis=1)
    path = []
    for piece in np.split(points, np.flatnonzero(np.diff(known)) + 1):
        if len(piece) and np.isfinite(piece[0]).all():
            kept = _turning_points(piece)
            path.append("M" + " ".join(_rounded(kept[0])))
            steps = " ".join(_rounded(np.diff(kept, axis=0).ravel()))
            path.append(f"l{re.sub(r'(?<![0-9])0[.]', '.', steps).replace(' -', '-')}" if steps else "")
    return "".join(path)


def _turning_points(points: FloatArray) -> FloatArray:
    """Drop repeated points of a polyline, shape (n, 2), and those on the straight way onwards."""
    moved = np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1))
    points = points[moved]
    steps = np.diff(points, axis=0)
    cross = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
    onwards = (np.abs(cross) < 1e-6) & (np.sum(steps[:-1] * steps[1:], axis=1) > 0)
    return points[np.concatenate([[True], ~onwards, [True]])] if len(points) > 2 else points


def _subscripts(words: str) -> Markup:
    marked = re.sub(
        r"(?<![\w.])([A-Za-zΑ-ω]{1,2})_([A-Za-z0-9]{1,6})(?![\w.])",
        r'\1<tspan dy="2.5" font-size="85%">\2</tspan><tspan dy="-2.5">&#8203;</tspan>',
        str(escape(words)),
    )
    return Markup(marked)
