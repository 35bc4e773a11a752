"""The model in a result: what it is, its signals, its diagram."""

from __future__ import annotations

from typing import Literal

from aero_bayes.schema.base import JsonTable


class SignalJson(JsonTable):
    """Unit and meaning of an input, output, state or port."""

    unit: str = ""
    description: str = ""


class ShapeJson(JsonTable):
    """A drawing primitive of an icon, in coordinates from -100 to 100; y points up."""

    kind: Literal["line", "polygon", "rectangle", "ellipse"]
    points: list[tuple[float, float]]
    filled: bool = False


class ComponentJson(JsonTable):
    """A part of the model, its place in the diagram (two opposite corners) and its icon.

    ``terminal`` says whether it is an input, an output or a connector of the model; ``marked`` that an effect was added
    there."""

    name: str
    type: str
    description: str = ""
    extent: tuple[float, float, float, float]
    rotation: float = 0.0
    shapes: list[ShapeJson] = []
    terminal: Literal["", "input", "output", "connector"] = ""
    marked: bool = False


class ConnectionJson(JsonTable):
    """A line between two components; ``signal`` where only a value is handed on. No points: drawn straight."""

    first: str
    second: str
    points: list[tuple[float, float]] = []
    signal: bool = False


class DiagramJson(JsonTable):
    """The model's structure; ``drawn`` says that its authors placed the parts, else they were laid out here."""

    title: str = ""
    drawn: bool = False
    components: list[ComponentJson] = []
    connections: list[ConnectionJson] = []


class ModelJson(JsonTable):
    """The model that was fitted."""

    name: str = ""
    fmu_sha256: str = ""
    exporter: str = ""
    engine: str = ""
