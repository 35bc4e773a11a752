"""The model's diagram: components with their icons, what connects them, and the place where an effect was added."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from markupsafe import Markup

from aero_bayes.report.figure import Plate
from aero_bayes.report.svg import ACCENT, INK, MUTED, WARM_COLOUR, Canvas
from aero_bayes.report.tables import html_table
from aero_bayes.report.text import greek_name
from aero_bayes.schema import ComponentJson, DiagramJson, ShapeJson

_WIDTH, _MOST_HIGH, _MARGIN = 440.0, 460.0, 26.0
_LETTER = 5.6

Place = Callable[[float, float], tuple[float, float]]


def diagram_plate(diagram: DiagramJson) -> Plate | None:
    """Return a diagram as a figure; None for an empty one."""
    if not diagram.components:
        return None
    marked = [c for c in diagram.components if c.marked]
    alt = f"Diagram of {diagram.title}: {', '.join(c.name for c in diagram.components)}."
    if marked:
        alt += f" An effect was added at {' and '.join(c.name for c in marked)}."
    canvas, place, scale = _paper(diagram, alt)
    by_name = {c.name: c for c in diagram.components}
    for line in diagram.connections:
        points = line.points or _line_between(by_name[line.first], by_name[line.second])
        at = np.array([place(x, y) for x, y in points])
        canvas.curve(at[:, 0], at[:, 1], MUTED, 0.9 if line.signal else 1.4, "3 3" if line.signal else "")
    for component in diagram.components:
        _draw(canvas, component, place, scale)
    rows = [
        (c.name, c.description or c.type.rpartition(".")[2], ", ".join(_neighbours(diagram, c.name)),
         "effect added here" if c.marked else "")
        for c in diagram.components
    ]  # fmt: skip
    caption = Markup("<strong>{}</strong>. {}").format(
        diagram.title,
        f"Marked: the place where {'an effect was' if len(marked) == 1 else 'effects were'} added." if marked else "",
    )
    return Plate(
        canvas.svg(), None, alt, caption, (), html_table(("part", "what it is", "connected to", ""), rows, alt)
    )


def _neighbours(diagram: DiagramJson, name: str) -> list[str]:
    ends = [(line.first, line.second) for line in diagram.connections]
    return list(dict.fromkeys(b if a == name else a for a, b in ends if name in (a, b)))


def _paper(diagram: DiagramJson, alt: str) -> tuple[Canvas, Place, float]:
    """Return a canvas that holds all components and lines, and where diagram coordinates go on it."""
    corners = [(x, y) for c in diagram.components for x, y in (c.extent[:2], c.extent[2:])]
    corners += [point for line in diagram.connections for point in line.points]
    xs, ys = zip(*corners, strict=True)
    across, up = max(max(xs) - min(xs), 60.0), max(max(ys) - min(ys), 20.0)
    scale = min((_WIDTH - 2 * _MARGIN) / across, (_MOST_HIGH - 2 * _MARGIN) / up, 2.6)
    left = 0.5 * (_WIDTH - scale * (min(xs) + max(xs)))

    def place(x: float, y: float) -> tuple[float, float]:
        return left + scale * x, _MARGIN - 6 + scale * (max(ys) - y)

    return Canvas(_WIDTH, scale * up + 2 * _MARGIN + 4, alt), place, scale


def _draw(canvas: Canvas, component: ComponentJson, place: Place, scale: float) -> None:
    x1, y1, x2, y2 = component.extent
    (left, top), (right, foot) = place(min(x1, x2), max(y1, y2)), place(max(x1, x2), min(y1, y2))
    middle = 0.5 * (left + right)
    if component.terminal == "connector":
        middle, y = 0.5 * (left + right), 0.5 * (top + foot)
        canvas.dots(np.array([middle]), np.array([y]), MUTED, 6.0, 1.0)
        foot, top = y + 4, y - 4
    elif component.terminal:
        side = min(5.0, 0.4 * (right - left))
        y = 0.5 * (top + foot)
        arrow = f"M{middle - side:.1f} {y - side:.1f}L{middle + side:.1f} {y:.1f}L{middle - side:.1f} {y + side:.1f}Z"
        canvas.shape(arrow, f"fill:var(--{ACCENT})")
        foot, top = y + side, y - side
    else:
        angle = math.radians(component.rotation)
        turn = math.cos(angle), math.sin(angle)

        def icon(x: float, y: float) -> tuple[float, float]:
            u, v = 0.005 * x * (x2 - x1), 0.005 * y * (y2 - y1)
            return place(0.5 * (x1 + x2) + turn[0] * u - turn[1] * v, 0.5 * (y1 + y2) + turn[1] * u + turn[0] * v)

        drawn = component.shapes or [ShapeJson(kind="rectangle", points=[(-100, -100), (100, 100)], filled=True)]
        for shape in drawn:
            outline = "".join(f"{'L' if k else 'M'}{x:.1f} {y:.1f}" for k, (x, y) in enumerate(_outline(shape, icon)))
            fill = "var(--panel)" if shape.filled else "none"
            colour = WARM_COLOUR if component.marked else INK
            end = "" if shape.kind == "line" else "Z"
            canvas.shape(outline + end, f"fill:{fill};stroke:var(--{colour});stroke-width:1.1")
    if component.marked:
        frame = f"M{left - 5:.1f} {top - 5:.1f}H{right + 5:.1f}V{foot + 5:.1f}H{left - 5:.1f}Z"
        canvas.shape(frame, f"fill:var(--{WARM_COLOUR});fill-opacity:.12;stroke:var(--{WARM_COLOUR});stroke-width:2")
        foot += 5
    room = max(2.2 * (right - left), 46.0)
    name = greek_name(component.name)
    size = max(8.5, min(11.0, 11.0 * room / (_LETTER * len(name))))
    canvas.text(middle, foot + 11, name, WARM_COLOUR if component.marked else MUTED, size, "middle")


def _outline(shape: ShapeJson, icon: Place) -> Iterator[tuple[float, float]]:
    (x1, y1), (x2, y2) = shape.points[0], shape.points[-1]
    if shape.kind == "rectangle":
        points = [(x1, y1), (x2, y1), (x2, y2), (x1, y2)]
    elif shape.kind == "ellipse":
        turns = np.linspace(0, 2 * math.pi, 24, endpoint=False)
        points = [(0.5 * (x1 + x2 + (x2 - x1) * math.cos(a)), 0.5 * (y1 + y2 + (y2 - y1) * math.sin(a))) for a in turns]
    else:
        points = shape.points
    return (icon(x, y) for x, y in points)


def _line_between(first: ComponentJson, second: ComponentJson) -> list[tuple[float, float]]:
    """Lead a line from the nearer side of one component to that of another, with one step between."""
    (a, b), (c, d) = _centre(first), _centre(second)
    half = [0.5 * abs(item.extent[2] - item.extent[0]) for item in (first, second)]
    if abs(c - a) <= half[0] + half[1]:  # one above the other
        tall = [0.5 * abs(item.extent[3] - item.extent[1]) for item in (first, second)]
        sign = math.copysign(1.0, d - b)
        return [(a, b + sign * tall[0]), (a, 0.5 * (b + d)), (c, 0.5 * (b + d)), (c, d - sign * tall[1])]
    sign = math.copysign(1.0, c - a)
    start, stop = a + sign * half[0], c - sign * half[1]
    knee = stop - sign * min(6.0, 0.5 * abs(stop - start))
    return [(start, b), (knee, b), (knee, d), (stop, d)]


def _centre(component: ComponentJson) -> tuple[float, float]:
    x1, y1, x2, y2 = component.extent
    return 0.5 * (x1 + x2), 0.5 * (y1 + y2)
