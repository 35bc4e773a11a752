"""The diagram of a model of components, with the places where effects were added. Points are complex numbers."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from aero_bayes.report.drawing import Plate
from aero_bayes.report.schema_run import ComponentJson, DiagramJson, ShapeJson
from aero_bayes.report.svg import ACCENT, INK, MUTED, WARM_COLOUR, Canvas
from aero_bayes.report.tables import html_table
from aero_bayes.report.text import greek_name

Points = NDArray[np.complex128]

_WIDTH, _MOST_HIGH, _MARGIN = 440.0, 460.0, 26.0
_LETTER = 5.6
_BOX = ShapeJson(kind="rectangle", points=[(-100, -100), (100, 100)], filled=True)


def diagram_plate(diagram: DiagramJson) -> Plate | None:
    """Return a diagram as a figure; None for one without the place of an effect."""
    marked = [c.name for c in diagram.components if c.marked]
    if not marked:
        return None
    parts = ", ".join(c.name for c in diagram.components)
    alt = f"Diagram of {diagram.title}: {parts}. An effect was added at {' and '.join(marked)}."
    canvas, place = _paper(diagram, alt)
    by_name = {c.name: c for c in diagram.components}
    for line in diagram.connections:
        middles = [complex(_points(by_name[end].extent).mean()) for end in (line.first, line.second)]
        at = place(_points(line.points) if line.points else np.array(middles))
        canvas.curve(at.real, at.imag, MUTED, 0.9 if line.signal else 1.4, "3 3" if line.signal else "")
    for component in diagram.components:
        _draw(canvas, component, place)
    ends = [(line.first, line.second) for line in diagram.connections]
    rows = [
        (c.name, c.description or c.type.rpartition(".")[2],
         ", ".join(dict.fromkeys(b if a == c.name else a for a, b in ends if c.name in (a, b))),
         "effect added here" if c.marked else "")
        for c in diagram.components
    ]  # fmt: skip
    caption = Markup("<strong>{}</strong>. {}").format(
        diagram.title,
        f"Marked: the place where {'an effect was' if len(marked) == 1 else 'effects were'} added.",
    )
    table = html_table(("part", "what it is", "connected to", ""), rows, alt)
    return Plate(canvas.svg(), alt, caption, table)


def _points(given: Any) -> Points:
    pairs = np.array(given, dtype=np.float64).reshape(-1, 2)
    return pairs[:, 0] + 1j * pairs[:, 1]


def _paper(diagram: DiagramJson, alt: str) -> tuple[Canvas, Callable[[Points], Points]]:
    """Return a canvas that holds all components and lines, and where diagram coordinates go on it."""
    at = np.concatenate([_points(item) for item in (
        *(c.extent for c in diagram.components), *(line.points for line in diagram.connections),
    )])  # fmt: skip
    across, up = max(np.ptp(at.real), 60.0), max(np.ptp(at.imag), 20.0)
    scale = float(min((_WIDTH - 2 * _MARGIN) / across, (_MOST_HIGH - 2 * _MARGIN) / up, 2.6))
    left, top = 0.5 * (_WIDTH - scale * (at.real.min() + at.real.max())), _MARGIN - 6 + scale * at.imag.max()
    return Canvas(_WIDTH, scale * up + 2 * _MARGIN + 4, alt), lambda z: left + 1j * top + scale * np.conj(z)


def _draw(canvas: Canvas, component: ComponentJson, place: Callable[[Points], Points]) -> None:
    first, last = _points(component.extent)
    ends = place(np.array([first, last]))
    (left, right), (top, foot), centre = sorted(ends.real), sorted(ends.imag), ends.mean()
    colour = WARM_COLOUR if component.marked else INK
    if component.terminal == "connector":
        canvas.dots(np.array([centre.real]), np.array([centre.imag]), MUTED, 6.0, 1.0)
        top, foot = centre.imag - 4, centre.imag + 4
    elif component.terminal:
        side = min(5.0, 0.4 * (right - left))
        canvas.outline(centre + side * np.array([-1 - 1j, 1, -1 + 1j]), f"fill:var(--{ACCENT})")
        top, foot = centre.imag - side, centre.imag + side
    else:
        half, turn = 0.005 * (last - first), cmath.exp(1j * math.radians(component.rotation))
        for shape in component.shapes or [_BOX]:
            own = _outline(shape)
            at = place(0.5 * (first + last) + turn * (half.real * own.real + 1j * half.imag * own.imag))
            fill = "var(--panel)" if shape.filled else "none"
            canvas.outline(at, f"fill:{fill};stroke:var(--{colour});stroke-width:1.1", closed=shape.kind != "line")
    if component.marked:
        corners = [(left - 5, top - 5), (right + 5, top - 5), (right + 5, foot + 5), (left - 5, foot + 5)]
        canvas.outline(_points(corners), f"fill:var(--{colour});fill-opacity:.12;stroke:var(--{colour});stroke-width:2")
        foot += 5
    name, room = greek_name(component.name), max(2.2 * (right - left), 46.0)
    size = max(8.5, min(11.0, 11.0 * room / (_LETTER * len(name))))
    canvas.text(centre.real, foot + 11, name, colour if component.marked else MUTED, size, "middle")


def _outline(shape: ShapeJson) -> Points:
    points = _points(shape.points)
    centre, half = 0.5 * (points[0] + points[-1]), 0.5 * (points[-1] - points[0])
    if shape.kind == "rectangle":
        return np.asarray(centre + half.real * np.array([-1, 1, 1, -1]) + 1j * half.imag * np.array([-1, -1, 1, 1]))
    if shape.kind == "ellipse":
        turns = np.linspace(0, 2 * math.pi, 24, endpoint=False)
        return np.asarray(centre + half.real * np.cos(turns) + 1j * half.imag * np.sin(turns))
    return points
