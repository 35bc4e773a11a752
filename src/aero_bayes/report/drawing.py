"""A figure of the page: drawings, alternative text and table, and the data of the script."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.report.svg import INK, MUTED, RULE, Canvas
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import minus, tidy
from aero_bayes.report.thinning import band_envelope, column_means, envelope

_FONT = 11.5
_RIGHT, _TITLE, _GAP, _FOOT = 14.0, 27.0, 9.0, 40.0


#: Terms of a sum of series: ``((1, "measured/run/y"), (-1, "after/run/y"))`` is what a model leaves.
Terms = tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Source:
    """Where the page's script finds a layer at full resolution: series to add up, over the series ``time``."""

    time: str
    terms: Terms
    upper: Terms = ()

    @property
    def keys(self) -> set[str]:
        """All series that are needed."""
        return {self.time, *(key for _, key in (*self.terms, *self.upper))}

    def spec(self, kind: str, label: str, *, held: bool = False) -> dict[str, object]:
        """Return it as the script reads it; ``kind`` is line, area, mean or dots."""
        found: dict[str, object] = {"k": kind, "t": self.time, "y": self.terms}
        return found | ({"u": self.upper} if self.upper else {}) | ({"n": label} if label else {}) \
            | ({"held": 1} if held else {})  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A curve; NaN values break it.

    ``cloud`` draws a noisy series as the area between its extremes, ``trend`` adds its slow part; ``held`` holds each
    value to the next."""

    x: FloatArray
    y: FloatArray
    colour: str
    width: float = 1.4
    dashes: bool = False
    label: str = ""
    source: Source | None = None
    cloud: float = 0.0
    trend: bool = False
    held: bool = False
    rms: bool = False


@dataclass(frozen=True)
class Band:
    """The area between two curves."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    colour: str
    opacity: float = 0.22
    edge: float = 0.0
    label: str = ""
    source: Source | None = None


@dataclass(frozen=True)
class Dots:
    """Single points; those with a ``source`` are readings, drawn at the edge of the panel where they are beyond it."""

    x: FloatArray
    y: FloatArray
    colour: str
    size: float = 1.6
    opacity: float = 0.5
    source: Source | None = None


Layer = Line | Band | Dots


@dataclass(frozen=True)
class Panel:
    """One pair of axes: what is drawn, and how it is named.

    ``title`` stands above the panel and names the quantity with its unit; ``levels`` are dashed horizontal lines;
    ``ticks`` is about how many values the y axis names, none for 0."""

    title: str
    layers: tuple[Layer, ...]
    height: float = 150
    y_limits: tuple[float, float] | None = None
    x_limits: tuple[float, float] | None = None
    levels: tuple[float, ...] = ()
    log_y: bool = False
    ticks: int = 4
    factor: float = 1.0


@dataclass(frozen=True)
class _PanelFrame:
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


def _columns_for(width: float) -> int:
    """Count the time columns of an envelope: about three for every four pixels."""
    return int(0.75 * width)


def draw(panels: Sequence[Panel], width: float, alt: str, x_label: str) -> Markup:
    """Draw panels one below the other over a common x axis."""
    height = sum(panel.height + _TITLE for panel in panels) + _GAP * (len(panels) - 1) + _FOOT
    canvas = Canvas(width, height, alt)
    x_limits = _x_limits(panels)
    scales = [_scale(panel) for panel in panels]
    longest = max((len(tick_text(tick)) for _, ticks in scales for tick in ticks), default=0)
    left = max(40.0, 14 + 0.62 * _FONT * longest)
    top = 0.0
    for panel, (y_limits, ticks) in zip(panels, scales, strict=True):
        frame = _PanelFrame(left, top + _TITLE, width - left - _RIGHT, panel.height, x_limits, y_limits, panel.log_y)
        canvas.group("panel", _panel_spec(panel, frame))
        canvas.text(3, top + 14, panel.title, INK, _FONT + 0.5)
        top += _TITLE
        _draw_panel(canvas, panel, frame, ticks, _columns_for(width))
        canvas.end()
        top += panel.height + _GAP
    canvas.group("x axis")
    _draw_x_axis(canvas, frame, x_label, 9 if width > 600 else 5)
    canvas.end()
    return canvas.svg()


def nice_ticks(low: float, high: float, most: int) -> list[float]:
    """Choose at most ``most`` round values between two ends: the finest step of 1, 2, 2.5 or 5 times a power of ten."""
    if not high > low or most < 1:
        return []
    power = 10.0 ** (math.floor(math.log10((high - low) / most)) - 1)
    for step in (factor * scale * power for scale in (1, 10, 100, 1000) for factor in (1, 2, 2.5, 5)):
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first < most:
            return [index * step for index in range(first, last + 1)]
    return []


def tick_text(value: float) -> str:
    """Return a tick's value without rounding dust."""
    return "0" if abs(value) < 1e-12 else f"{value:.6g}".replace("-", "−")


def _x_limits(panels: Sequence[Panel]) -> tuple[float, float]:
    given = [panel.x_limits for panel in panels if panel.x_limits]
    if given:
        return given[0]
    xs = [layer.x for panel in panels for layer in panel.layers if len(layer.x)]
    low, high = min(float(np.nanmin(x)) for x in xs), max(float(np.nanmax(x)) for x in xs)
    return low, high if high > low else low + 1.0


def _scale(panel: Panel) -> tuple[tuple[float, float], list[float]]:
    """Choose limits of the y axis, a little beyond what is drawn, and its ticks."""
    low, high = panel.y_limits or _reach(panel)
    if panel.log_y:
        decades = [10.0**power for power in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)]
        every = [factor * decade for decade in decades for factor in ((1,) if len(decades) > 3 else (1, 2, 5))]
        return (low, high), [tick for tick in every if low <= tick <= high]
    return (low, high), nice_ticks(low, high, panel.ticks)


def _reach(panel: Panel) -> tuple[float, float]:
    layers = [layer for layer in panel.layers if not (isinstance(layer, Dots) and layer.source)]
    drawn = [part for layer in layers for part in ((layer.low, layer.high) if isinstance(layer, Band) else (layer.y,))]
    seen = [layer.x for layer in layers for _ in range(2 if isinstance(layer, Band) else 1)]
    if panel.x_limits is not None:
        first, last = panel.x_limits
        drawn = [y[(x >= first) & (x <= last)] for x, y in zip(seen, drawn, strict=True)]
    values = np.concatenate([*drawn, np.array(panel.levels, dtype=np.float64)])
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if panel.log_y:
        return low / 1.15, high * 1.15
    spare = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - spare, high + spare


def _panel_spec(panel: Panel, frame: _PanelFrame) -> dict[str, object] | None:
    """Return the data that the script needs to redraw a panel; None for a static one."""
    if not any(isinstance(layer, Line | Band) and layer.source for layer in panel.layers):
        return None
    box = [round(side, 1) for side in (frame.left, frame.top, frame.width, frame.height)]
    spec: dict[str, object] = {"box": box, "x": frame.x_limits, "y": frame.y_limits, "f": panel.factor}
    spec |= {"ticks": panel.ticks, "levels": panel.levels, "title": panel.title}
    return spec | ({"fixed": 1} if panel.y_limits is not None else {})


def _draw_panel(canvas: Canvas, panel: Panel, frame: _PanelFrame, ticks: Sequence[float], columns: int) -> None:
    right, foot = frame.left + frame.width, frame.top + frame.height
    canvas.group("y axis")
    for tick, y in zip(ticks, frame.down(np.array(ticks)).tolist(), strict=True):
        canvas.curve([frame.left, right], [y, y], RULE, 0.8)
        canvas.text(frame.left - 6, y + 4, tick_text(tick), MUTED, _FONT, "end")
    canvas.curve([frame.left, right], [foot, foot], RULE, 0.8)
    for y in frame.down(np.array(panel.levels)).tolist():
        canvas.curve([frame.left, right], [y, y], MUTED, 0.9, "4 3")
    canvas.end()
    cut = panel.y_limits is not None or panel.x_limits is not None or _panel_spec(panel, frame) is not None
    if cut:
        canvas.clip(frame.left, frame.top, frame.width, frame.height)
    for layer in sorted(panel.layers, key=lambda layer: isinstance(layer, Line) and not layer.cloud):
        match layer:
            case Line():
                _draw_line(canvas, layer, frame, columns)
            case Band():
                data = layer.source.spec("area", layer.label) if layer.source else None
                seen = _seen(frame, layer.x, layer.low, layer.high)
                x, low, high = band_envelope(seen[0], seen[1], seen[2], columns)
                area = frame.across(x), frame.down(low), frame.down(high)
                canvas.area(*area, layer.colour, layer.opacity, layer.edge, data)
            case Dots():
                down, data = frame.down(layer.y), layer.source.spec("dots", "") if layer.source else None
                if data:
                    down = np.clip(down, frame.top + layer.size, frame.top + frame.height - layer.size)
                canvas.dots(frame.across(layer.x), down, layer.colour, layer.size, layer.opacity, data)
    if cut:
        canvas.end()


def _draw_line(canvas: Canvas, layer: Line, frame: _PanelFrame, columns: int) -> None:
    x, y = _seen(frame, layer.x, layer.y)
    source = layer.source
    if layer.cloud and len(x) > 4 * columns:
        at, low, high = band_envelope(x, y, y, columns)
        data = source.spec("area", layer.label) if source else None
        edge = 2.5 * layer.cloud - 0.4
        canvas.area(frame.across(at), frame.down(low), frame.down(high), layer.colour, layer.cloud, edge, data)
        if layer.trend:
            at, middle = column_means(x, y, columns // 4)
            data = source.spec("mean", "") if source else None
            canvas.curve(frame.across(at), frame.down(middle), layer.colour, 1.6, "", data)
        return
    if layer.held and len(x) <= 2 * columns:
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    x, y = envelope(x, y, columns)
    data = source.spec("line", layer.label, held=layer.held) if source else None
    canvas.curve(frame.across(x), frame.down(y), layer.colour, layer.width, "5 3" if layer.dashes else "", data)


def _seen(frame: _PanelFrame, x: FloatArray, *values: FloatArray) -> tuple[FloatArray, ...]:
    """Return what lies within the frame, and one point to either side."""
    first, last = np.searchsorted(x, frame.x_limits[0]) - 1, np.searchsorted(x, frame.x_limits[1], "right") + 1
    part = slice(max(0, int(first)), int(last)) if len(x) > 1 and np.all(np.diff(x) >= 0) else slice(None)
    return (x[part], *(v[part] for v in values))


def _draw_x_axis(canvas: Canvas, frame: _PanelFrame, label: str, most: int) -> None:
    right, foot = frame.left + frame.width, frame.top + frame.height
    canvas.curve([frame.left, right], [foot, foot], MUTED, 0.8)
    ticks = nice_ticks(*frame.x_limits, most)
    for tick, x in zip(ticks, frame.across(np.array(ticks)).tolist(), strict=True):
        canvas.curve([x, x], [foot, foot + 3], MUTED, 0.8)
        canvas.text(x, foot + 15, tick_text(tick), MUTED, _FONT, "middle")
    canvas.text(frame.left + frame.width / 2, foot + 34, label, MUTED, _FONT, "middle")


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
