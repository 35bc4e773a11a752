"""Inline SVG that takes its colours from the page's CSS variables, so that one drawing serves light, dark and print."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike

from aero_bayes.arrays import FloatArray

INK, MUTED, RULE, MEASURED, ACCENT, WARM_COLOUR = "ink", "muted", "rule", "measured", "accent", "warm"
SERIES = tuple(f"s{number}" for number in range(1, 7))


class Canvas:
    """A drawing under construction, in CSS pixels from the top left corner.

    Colours are names of the page's CSS variables. Coordinates are rounded to a tenth of a pixel."""

    def __init__(self, width: float, height: float, alt: str) -> None:
        self._size = width, height
        self._alt = alt
        self._parts: list[Markup] = []
        self._clips = 0

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
        self, x: float, y: float, words: str, colour: str = MUTED, size: float = 11.5, anchor: str = "start"
    ) -> None:
        """Write words on the base line at (x, y); R_a is set with a subscript. ``anchor``: start, middle or end."""
        where = Markup(
            '<text x="{:.1f}" y="{:.1f}" font-size="{:.3g}" text-anchor="{}" style="fill:var(--{})">{}</text>'
        )
        self._parts.append(where.format(x, y, size, anchor, colour, _subscripts(words)))

    def shape(self, outline: str, style: str) -> None:
        """Draw SVG path data with a style."""
        self._path(outline, style)

    def group(self, css_class: str, data: Mapping[str, object] | None = None) -> None:
        """Begin a group, to which belongs what is drawn from here to ``end``."""
        self._parts.append(Markup('<g class="{}"{}>').format(css_class, _attribute(data)))

    def clip(self, left: float, top: float, width: float, height: float) -> None:
        """Cut off what is drawn from here to ``end`` outside a frame."""
        self._clips += 1
        name = f"c{hashlib.sha256(f'{self._alt}{self._size}'.encode()).hexdigest()[:10]}{self._clips}"
        self._parts.append(
            Markup(
                '<clipPath id="{0}"><rect x="{1:.1f}" y="{2:.1f}" width="{3:.1f}" height="{4:.1f}"/></clipPath>'
                '<g clip-path="url(#{0})">'
            ).format(name, left, top, width, height)
        )

    def end(self) -> None:
        """End what ``group`` or ``clip`` began."""
        self._parts.append(Markup("</g>"))

    def svg(self) -> Markup:
        """Write the drawing as an ``<svg>`` element with its alternative text."""
        width, height = self._size
        frame = Markup(
            '<svg class="plot" viewBox="0 0 {0:g} {1:g}" style="max-width:{0:.0f}px" role="img" aria-label="{2}">'
            "{3}</svg>"
        )
        return frame.format(round(width, 1), round(height, 1), self._alt, Markup("").join(self._parts))

    def _path(self, outline: str, style: str, data: Mapping[str, object] | None = None) -> None:
        if outline or data:
            self._parts.append(Markup('<path d="{}" style="{}"{}/>').format(outline, style, _attribute(data)))


def _attribute(data: Mapping[str, object] | None) -> Markup:
    if data is None:
        return Markup("")
    return Markup(' data-spec="{}"').format(json.dumps(data, ensure_ascii=False, separators=(",", ":")))


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
