"""Panels of curves over a common x axis: the one kind of figure that most of the page is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from aero_bayes.report.svg import INK, MUTED, RULE, Canvas
from aero_bayes.report.thinning import band_envelope, column_means, envelope

FloatArray = NDArray[np.float64]

_FONT = 11.5
_RIGHT, _TITLE, _GAP, _FOOT = 14.0, 27.0, 9.0, 40.0


@dataclass(frozen=True)
class Line:
    """A curve; NaN values break it."""

    x: FloatArray
    y: FloatArray
    colour: str
    width: float = 1.4
    dashes: bool = False


@dataclass(frozen=True)
class Band:
    """The area between two curves."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    colour: str
    opacity: float = 0.22
    edge: float = 0.0


@dataclass(frozen=True)
class Dots:
    """Single points."""

    x: FloatArray
    y: FloatArray
    colour: str
    size: float = 1.6
    opacity: float = 0.5


Layer = Line | Band | Dots


@dataclass(frozen=True)
class Panel:
    """One pair of axes: what is drawn, and how it is named.

    ``title`` stands above the panel and names the quantity with its unit; ``levels`` are dashed horizontal lines;
    ``ticks`` is about how many values the y axis names, none for 0.
    """

    title: str
    layers: tuple[Layer, ...]
    height: float = 150
    y_limits: tuple[float, float] | None = None
    x_limits: tuple[float, float] | None = None
    levels: tuple[float, ...] = ()
    log_y: bool = False
    ticks: int = 4


@dataclass(frozen=True)
class Plate:
    """A figure of the page: drawing for wide screens, one for phones, words for those who do not see it."""

    wide: Markup
    narrow: Markup | None
    alt: str
    caption: Markup
    legend: tuple[tuple[str, str], ...] = field(default=())


@dataclass(frozen=True)
class _Frame:
    """Where a panel's values go on the canvas."""

    left: float
    top: float
    width: float
    height: float
    x_limits: tuple[float, float]
    y_limits: tuple[float, float]
    log_y: bool

    def across(self, x: FloatArray) -> FloatArray:
        low, high = self.x_limits
        return self.left + self.width * (np.asarray(x, dtype=np.float64) - low) / (high - low)

    def down(self, y: FloatArray) -> FloatArray:
        low, high = (math.log10(end) if self.log_y else end for end in self.y_limits)
        values = np.asarray(y, dtype=np.float64)
        if self.log_y:
            values = np.log10(np.maximum(values, 1e-300))
        return self.top + self.height * (1 - (values - low) / (high - low))


def line(time: FloatArray, values: FloatArray, colour: str, columns: int, width: float = 1.4) -> Line:
    """A curve thinned to its envelope over ``columns`` columns."""
    return Line(*envelope(time, values, columns), colour, width)


def cloud(
    time: FloatArray, values: FloatArray, colour: str, columns: int, *, opacity: float = 0.4, trend: bool = False
) -> tuple[Layer, ...]:
    """A noisy series: the area between its extremes, and on request its slow part; a curve where it is short."""
    if len(time) <= 4 * columns:
        return (line(time, values, colour, columns, 1.1),)
    area = Band(*band_envelope(time, values, values, columns), colour, opacity, edge=2.5 * opacity - 0.4)
    slow = Line(*column_means(time, values, columns // 4), colour, 1.6)
    return (area, slow) if trend else (area,)


def band(time: FloatArray, low: FloatArray, high: FloatArray, colour: str, columns: int, opacity: float = 0.22) -> Band:
    """A band thinned to its envelope over ``columns`` columns."""
    return Band(*band_envelope(time, low, high, columns), colour, opacity)


def draw(panels: Sequence[Panel], width: float, alt: str, x_label: str) -> Markup:
    """Panels one below the other over a common x axis.

    Parameters
    ----------
    panels : sequence of Panel
        From top to bottom; heights in CSS pixels.
    width : float
        Width of the drawing in CSS pixels: the size at which its text has its true size.
    alt : str
        What the figure shows, for a screen reader.
    x_label : str
        Name and unit of the common x axis.

    Returns
    -------
    Markup
        An ``<svg>`` element.
    """
    height = sum(panel.height + _TITLE for panel in panels) + _GAP * (len(panels) - 1) + _FOOT
    canvas = Canvas(width, height, alt)
    x_limits = _x_limits(panels)
    scales = [_scale(panel) for panel in panels]
    longest = max((len(tick_text(tick)) for _, ticks in scales for tick in ticks), default=0)
    left = max(40.0, 14 + 0.62 * _FONT * longest)
    top = 0.0
    for panel, (y_limits, ticks) in zip(panels, scales, strict=True):
        canvas.text(3, top + 14, panel.title, INK, _FONT + 0.5)
        top += _TITLE
        frame = _Frame(left, top, width - left - _RIGHT, panel.height, x_limits, y_limits, panel.log_y)
        _draw_panel(canvas, panel, frame, ticks)
        top += panel.height + _GAP
    _draw_x_axis(canvas, frame, x_label, 9 if width > 600 else 5)
    return canvas.svg()


def nice_ticks(low: float, high: float, most: int) -> list[float]:
    """At most ``most`` round values between two ends: the finest step of 1, 2, 2.5 or 5 times a power of ten."""
    if not high > low or most < 1:
        return []
    power = 10.0 ** (math.floor(math.log10((high - low) / most)) - 1)
    for step in (factor * scale * power for scale in (1, 10, 100, 1000) for factor in (1, 2, 2.5, 5)):
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first < most:
            return [index * step for index in range(first, last + 1)]
    return []


def tick_text(value: float) -> str:
    """A tick's value without rounding dust."""
    return "0" if abs(value) < 1e-12 else f"{value:.6g}".replace("-", "−")


def _x_limits(panels: Sequence[Panel]) -> tuple[float, float]:
    given = [panel.x_limits for panel in panels if panel.x_limits]
    if given:
        return given[0]
    xs = [layer.x for panel in panels for layer in panel.layers if len(layer.x)]
    low, high = min(float(np.nanmin(x)) for x in xs), max(float(np.nanmax(x)) for x in xs)
    return low, high if high > low else low + 1.0


def _scale(panel: Panel) -> tuple[tuple[float, float], list[float]]:
    """Limits of the y axis, a little beyond what is drawn, and its ticks."""
    low, high = panel.y_limits or _reach(panel)
    if panel.log_y:
        decades = [10.0**power for power in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)]
        every = [factor * decade for decade in decades for factor in ((1,) if len(decades) > 3 else (1, 2, 5))]
        return (low, high), [tick for tick in every if low <= tick <= high]
    return (low, high), nice_ticks(low, high, panel.ticks)


def _reach(panel: Panel) -> tuple[float, float]:
    drawn = [
        part for layer in panel.layers for part in ((layer.low, layer.high) if isinstance(layer, Band) else (layer.y,))
    ]
    values = np.concatenate([*drawn, np.array(panel.levels, dtype=np.float64)])
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if panel.log_y:
        return low / 1.15, high * 1.15
    spare = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - spare, high + spare


def _draw_panel(canvas: Canvas, panel: Panel, frame: _Frame, ticks: Sequence[float]) -> None:
    right, foot = frame.left + frame.width, frame.top + frame.height
    for tick, y in zip(ticks, frame.down(np.array(ticks)).tolist(), strict=True):
        canvas.curve([frame.left, right], [y, y], RULE, 0.8)
        canvas.text(frame.left - 6, y + 4, tick_text(tick), MUTED, _FONT, "end")
    canvas.curve([frame.left, right], [foot, foot], RULE, 0.8)
    for y in frame.down(np.array(panel.levels)).tolist():
        canvas.curve([frame.left, right], [y, y], MUTED, 0.9, "4 3")
    cut = panel.y_limits is not None or panel.x_limits is not None
    if cut:
        canvas.clip(frame.left, frame.top, frame.width, frame.height)
    for layer in sorted(panel.layers, key=lambda layer: isinstance(layer, Line)):
        match layer:
            case Line():
                dashes = "5 3" if layer.dashes else ""
                canvas.curve(frame.across(layer.x), frame.down(layer.y), layer.colour, layer.width, dashes)
            case Band():
                low, high = frame.down(layer.low), frame.down(layer.high)
                canvas.area(frame.across(layer.x), low, high, layer.colour, layer.opacity, layer.edge)
            case Dots():
                canvas.dots(frame.across(layer.x), frame.down(layer.y), layer.colour, layer.size, layer.opacity)
    if cut:
        canvas.unclip()


def _draw_x_axis(canvas: Canvas, frame: _Frame, label: str, most: int) -> None:
    right, foot = frame.left + frame.width, frame.top + frame.height
    canvas.curve([frame.left, right], [foot, foot], MUTED, 0.8)
    ticks = nice_ticks(*frame.x_limits, most)
    for tick, x in zip(ticks, frame.across(np.array(ticks)).tolist(), strict=True):
        canvas.curve([x, x], [foot, foot + 3], MUTED, 0.8)
        canvas.text(x, foot + 15, tick_text(tick), MUTED, _FONT, "middle")
    canvas.text(frame.left + frame.width / 2, foot + 34, label, MUTED, _FONT, "middle")
