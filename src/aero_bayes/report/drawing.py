"""A figure of the page: one drawing for every width, its alternative text and table, and the data of the script."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.report.svg import INK, WIDTH, Canvas
from aero_bayes.report.tables import html_table
from aero_bayes.report.text import minus, tidy

_TITLE, _GAP, _FOOT = 27.0, 9.0, 40.0
#: Time columns of an envelope: more than one for every two pixels of a wide figure, and of a small one.
_WIDE_COLUMNS, _SMALL_COLUMNS = 640, 200
_STRETCHES = 12


@dataclass(frozen=True)
class Line:
    """A curve; NaN values break it.

    ``cloud`` draws a noisy series as the area between its extremes, ``trend`` adds its slow part; ``held`` holds each
    value to the next."""

    x: FloatArray
    y: FloatArray
    colour: str
    width: float = 1.4
    label: str = ""
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
    label: str = ""


@dataclass(frozen=True)
class Dots:
    """Single points; ``at_edge`` draws those beyond the panel at its edge, in place of making room for them."""

    x: FloatArray
    y: FloatArray
    colour: str
    size: float = 1.6
    opacity: float = 0.5
    at_edge: bool = False


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


@dataclass(frozen=True)
class Plate:
    """A figure: its drawing, alternative text and table.

    Figures of one ``link`` zoom together; ``series`` are the curves at full resolution that the script draws from. One
    that ``scrolls`` keeps its width on a narrow screen."""

    drawing: Markup
    alt: str
    caption: Markup
    table: Markup
    legend: tuple[tuple[str, str], ...] = ()
    link: str = ""
    series: dict[str, FloatArray] = field(default_factory=dict)
    scrolls: bool = False


def plate(
    panels: Sequence[Panel],
    alt: str,
    x_label: str,
    caption: Markup | str = "",
    *,
    legend: tuple[tuple[str, str], ...] = (),
    link: str = "",
    small: bool = False,
) -> Plate:
    """Make panels a figure; one with a ``link`` can be zoomed."""
    series: dict[str, FloatArray] | None = {} if link else None
    drawing = draw(panels, alt, x_label, series, small=small).svg()
    return Plate(drawing, alt, Markup.escape(caption), data_table(panels, x_label, alt), legend, link, series or {})


def draw(
    panels: Sequence[Panel],
    alt: str,
    x_label: str,
    series: dict[str, FloatArray] | None = None,
    *,
    small: bool = False,
) -> Canvas:
    """Draw panels one below the other over a common x axis; fill ``series`` with what a script needs to zoom it."""
    scales = [_scale(panel) for panel in panels]
    longest = max((len(tick_text(tick)) for _, ticks in scales for tick in ticks), default=0)
    left = max(40.0, 14 + 7.13 * longest)
    height = sum(panel.height + _TITLE for panel in panels) + _GAP * (len(panels) - 1) + _FOOT
    canvas = Canvas(WIDTH, height, alt, left)
    x_limits, top = limits_of_x(panels), 0.0
    for panel, (y_limits, ticks) in zip(panels, scales, strict=True):
        top += _TITLE
        frame = _Frame(panel, top, x_limits, y_limits, _SMALL_COLUMNS if small else _WIDE_COLUMNS, series)
        canvas.group("panel", frame.spec())
        canvas.text(3 - left, top - 13, panel.title, INK, 12)
        frame.draw(canvas, ticks)
        canvas.end()
        top += panel.height + _GAP
    _draw_x_axis(canvas, top - _GAP, x_limits, x_label, small)
    return canvas


@dataclass(frozen=True)
class _Frame:
    """Where a panel's values go: in an inner drawing that is as wide as the page lets it be, ``WIDTH`` for itself."""

    panel: Panel
    top: float
    x_limits: tuple[float, float]
    y_limits: tuple[float, float]
    columns: int
    series: dict[str, FloatArray] | None

    def across(self, x: FloatArray) -> FloatArray:
        low, high = self.x_limits
        return WIDTH * (x - low) / (high - low)

    def down(self, y: FloatArray) -> FloatArray:
        low, high = self.y_limits
        if self.panel.log_y:
            low, high, y = math.log10(low), math.log10(high), np.log10(np.maximum(y, 1e-300))
        return self.panel.height * (1 - (y - low) / (high - low))

    def spec(self) -> dict[str, object] | None:
        """Return what the script needs to draw the panel anew; None for a still one."""
        if self.series is None:
            return None
        found = {"top": self.top, "height": self.panel.height, "x": self.x_limits, "y": self.y_limits,
                 "ticks": self.panel.ticks, "levels": self.panel.levels}  # fmt: skip
        return found | ({"fixed": 1} if self.panel.y_limits is not None else {})

    def layer_spec(self, kind: str, layer: Layer, label: str = "") -> dict[str, object] | None:
        """Return the same of a layer, whose kind is line, area, mean or dots, and keep its curves."""
        if self.series is None:
            return None
        kept = {"t": layer.x, "y": layer.low if isinstance(layer, Band) else layer.y}
        kept |= {"u": layer.high} if isinstance(layer, Band) else {}
        found: dict[str, object] = {"k": kind, **({"n": label} if label else {})}
        for name, values in kept.items():
            found[name] = key = hashlib.sha256(values.tobytes()).hexdigest()[:10]
            self.series[key] = values
        return found | ({"held": 1} if isinstance(layer, Line) and layer.held else {})

    def draw(self, canvas: Canvas, ticks: Sequence[float]) -> None:
        panel = self.panel
        canvas.group("y axis")
        for tick, y in zip(ticks, (self.top + self.down(np.array(ticks))).tolist(), strict=True):
            canvas.rule(y, "grid")
            canvas.tick(-6, y + 4, tick_text(tick), "end")
        canvas.rule(self.top + panel.height, "grid")
        for y in (self.top + self.down(np.array(panel.levels))).tolist():
            canvas.rule(y, "level")
        canvas.end()
        cut = panel.y_limits is not None or panel.x_limits is not None or self.series is not None
        canvas.window(self.top, panel.height, cut=cut)
        for layer in sorted(panel.layers, key=lambda layer: isinstance(layer, Line) and not layer.cloud):
            match layer:
                case Line():
                    self._draw_line(canvas, layer)
                case Band():
                    x, low, high = self._seen(layer.x, layer.low, layer.high)
                    x, low, high = band_envelope(x, low, high, self.columns)
                    spec = self.layer_spec("area", layer, layer.label)
                    area = self.across(x), self.down(low), self.down(high)
                    canvas.area(*area, layer.colour, layer.opacity, 0, spec)
                case Dots():
                    down = self.down(layer.y)
                    if layer.at_edge:
                        down = np.clip(down, layer.size, panel.height - layer.size)
                    spec = self.layer_spec("dots", layer)
                    canvas.dots(self.across(layer.x), down, layer.colour, layer.size, layer.opacity, spec)
        canvas.end()

    def _draw_line(self, canvas: Canvas, layer: Line) -> None:
        x, y = self._seen(layer.x, layer.y)
        if layer.cloud and len(x) > 4 * self.columns:
            at, low, high = band_envelope(x, y, y, self.columns)
            spec = self.layer_spec("area", layer, layer.label)
            area = self.across(at), self.down(low), self.down(high)
            canvas.area(*area, layer.colour, layer.cloud, 2.5 * layer.cloud - 0.4, spec)
            if layer.trend:
                at, middle = column_means(x, y, self.columns // 4)
                spec = self.layer_spec("mean", layer)
                canvas.curve(self.across(at), self.down(middle), layer.colour, 1.6, "", spec)
            return
        if layer.held and len(x) <= 2 * self.columns:
            x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
        x, y = envelope(x, y, self.columns)
        spec = self.layer_spec("line", layer, layer.label)
        canvas.curve(self.across(x), self.down(y), layer.colour, layer.width, "", spec)

    def _seen(self, x: FloatArray, *values: FloatArray) -> tuple[FloatArray, ...]:
        """Return what lies within the frame, and one point to either side."""
        first, last = np.searchsorted(x, self.x_limits[0]) - 1, np.searchsorted(x, self.x_limits[1], "right") + 1
        part = slice(max(0, int(first)), int(last)) if len(x) > 1 and np.all(np.diff(x) >= 0) else slice(None)
        return (x[part], *(v[part] for v in values))


def _draw_x_axis(canvas: Canvas, foot: float, limits: tuple[float, float], label: str, small: bool) -> None:
    low, high = limits
    canvas.group("x axis" if small else "x axis many")
    canvas.rule(foot, "base")
    for tick in nice_ticks(low, high, 5 if small else 9):
        x = f"{100 * (tick - low) / (high - low):.2f}%"
        canvas.notch(x, foot)
        canvas.tick(x, foot + 15, tick_text(tick), "middle")
    canvas.text("50%", foot + 34, label, anchor="middle")
    canvas.end()


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
    return "0" if abs(value) < 1e-12 else minus(f"{value:.6g}")


def limits_of_x(panels: Sequence[Panel]) -> tuple[float, float]:
    """Return the ends of the common x axis: those that a panel gives, else those of the curves."""
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
    first, last = panel.x_limits or (-math.inf, math.inf)
    drawn = [
        y[(layer.x >= first) & (layer.x <= last)]
        for layer in panel.layers if not (isinstance(layer, Dots) and layer.at_edge)
        for y in ((layer.low, layer.high) if isinstance(layer, Band) else (layer.y,))
    ]  # fmt: skip
    values = np.concatenate([*drawn, np.array(panel.levels, dtype=np.float64)])
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if panel.log_y:
        return low / 1.15, high * 1.15
    spare = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - spare, high + spare


def data_table(panels: Sequence[Panel], x_label: str, alt: str) -> Markup:
    """Return the labelled layers of a figure as a table.

    Means over equal stretches of the x axis, RMS for residuals."""
    shown = [
        (panel, layer) for panel in panels for layer in panel.layers if not isinstance(layer, Dots) and layer.label
    ]
    if not shown:
        return Markup("")
    heads = [x_label]
    for panel, layer in shown:
        words = f"{layer.label}, RMS" if isinstance(layer, Line) and layer.rms else layer.label
        heads.append(f"{panel.title}: {words}")
    edges = np.linspace(*limits_of_x(panels), _STRETCHES + 1)
    edges[np.abs(edges) < 1e-9 * np.ptp(edges)] = 0.0  # the middle of an even range is there but for rounding
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


def envelope(time: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Thin a series to the least and the greatest value of every time column.

    A dropped sample can hide a spike; the extremes of each column, joined by lines, look as the whole series does."""
    if len(time) <= 2 * columns:
        return time, values
    starts = _column_starts(time, columns)
    low = np.fmin.reduceat(values, starts)
    high = np.fmax.reduceat(values, starts)
    ends = np.append(starts[1:], len(time)) - 1
    falling = values[ends] < values[starts]
    thinned = np.empty(2 * len(starts))
    thinned[0::2] = np.where(falling, high, low)
    thinned[1::2] = np.where(falling, low, high)
    times = np.empty_like(thinned)
    times[0::2] = time[starts]
    times[1::2] = time[ends]
    return times, thinned


def band_envelope(
    time: FloatArray, low: FloatArray, high: FloatArray, columns: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Thin a band to its least lower and greatest upper edge of every time column."""
    if len(time) <= columns:
        return time, low, high
    starts = _column_starts(time, columns)
    ends = np.append(starts[1:], len(time)) - 1
    middle = 0.5 * (time[starts] + time[ends])
    middle[0], middle[-1] = time[0], time[-1]
    return middle, np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def column_means(time: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Compute the mean of every time column: the slow part of a noisy series."""
    starts = _column_starts(time, columns)
    sizes = np.add.reduceat(np.isfinite(values).astype(np.float64), starts)
    sums = np.add.reduceat(np.where(np.isfinite(values), values, 0.0), starts)
    ends = np.append(starts[1:], len(time)) - 1
    return 0.5 * (time[starts] + time[ends]), np.divide(sums, sizes, out=np.full(len(starts), np.nan), where=sizes > 0)


def _column_starts(time: FloatArray, columns: int) -> NDArray[np.intp]:
    span = time[-1] - time[0]
    column = np.minimum(((time - time[0]) / span * columns).astype(np.intp), columns - 1)
    return np.flatnonzero(np.diff(column, prepend=-1))
