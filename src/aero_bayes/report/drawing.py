"""Matplotlib figures as inline SVG that takes its colours from the page, so that one drawing serves light and dark."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from aero_bayes.report.thinning import band_envelope, column_means, envelope

FloatArray = NDArray[np.float64]

# Colours that no drawing uses otherwise; each is replaced by a CSS variable of the page.
INK, MUTED, RULE, MEASURED, ACCENT, WARM = (f"#fe00{index:02x}" for index in range(6))
SERIES = tuple(f"#fe01{index:02x}" for index in range(6))
_VARIABLES = dict(
    zip((INK, MUTED, RULE, MEASURED, ACCENT, WARM), ["ink", "muted", "rule", "measured", "accent", "warm"], strict=True)
)
_VARIABLES |= {colour: f"s{index + 1}" for index, colour in enumerate(SERIES)}
_FONT = 11.5


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
    size: float = 2.5
    opacity: float = 0.45


@dataclass(frozen=True)
class Panel:
    """One pair of axes: what is drawn, and how it is named.

    ``title`` stands above the panel and names the quantity with its unit.
    """

    title: str
    layers: tuple[Layer, ...]
    height: float = 150
    y_limits: tuple[float, float] | None = None
    x_limits: tuple[float, float] | None = None
    levels: tuple[float, ...] = ()
    log_y: bool = False
    ticks: int = 4


Layer = Line | Band | Dots


@dataclass(frozen=True)
class Plate:
    """A figure of the page: drawing for wide screens, one for phones, words for those who do not see it."""

    wide: Markup
    narrow: Markup | None
    alt: str
    caption: Markup
    legend: tuple[tuple[str, str], ...] = field(default=())


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
    right, title, gap, foot = 14.0, 25.0, 10.0, 40.0
    height = sum(panel.height + title for panel in panels) + gap * (len(panels) - 1) + foot
    figure = Figure(figsize=(width / 72, height / 72), dpi=72)
    limits = _common_limits(panels)
    frames = []
    for index, panel in enumerate(panels):
        axes = figure.add_axes((0, 0, 1, 1), label=str(index))
        _fill(axes, panel, limits)
        frames.append(axes)
        _style(axes, panel, width, last=index == len(panels) - 1)
    left = max(_label_width(axes) for axes in frames)
    top = height
    for axes, panel in zip(frames, panels, strict=True):
        figure.text(3 / width, (top - 15) / height, panel.title, fontsize=_FONT + 0.5, color=INK, parse_math=False)
        top -= title + panel.height
        axes.set_position((left / width, top / height, (width - left - right) / width, panel.height / height))
        top -= gap
    middle = (left + (width - left - right) / 2) / width
    figure.text(middle, 5 / height, x_label, ha="center", fontsize=_FONT, color=MUTED, parse_math=False)
    return to_svg(figure, alt)


def to_svg(figure: Figure, alt: str) -> Markup:
    """A figure as an inline ``<svg>`` with real text and the page's colours; needs no global Matplotlib state."""
    buffer = io.StringIO()
    salt = hashlib.sha256(alt.encode() + repr(figure.get_size_inches().tolist()).encode()).hexdigest()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": salt, "path.simplify_threshold": 0.2}):
        figure.savefig(
            buffer, format="svg", transparent=True, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type"))
        )
    return Markup(_lighten(buffer.getvalue(), alt))


def _common_limits(panels: Sequence[Panel]) -> tuple[float, float]:
    given = [panel.x_limits for panel in panels if panel.x_limits]
    if given:
        return given[0]
    xs = [layer.x for panel in panels for layer in panel.layers if len(layer.x)]
    low, high = min(np.nanmin(x) for x in xs), max(np.nanmax(x) for x in xs)
    return float(low), float(high) if high > low else float(low) + 1.0


def _fill(axes: Axes, panel: Panel, x_limits: tuple[float, float]) -> None:
    if panel.log_y:
        axes.set_yscale("log")
    for level in panel.levels:
        axes.axhline(level, color=MUTED, linewidth=0.9, dashes=(4, 3), zorder=1.5)
    for layer in panel.layers:
        match layer:
            case Line():
                style = (0, (5, 3)) if layer.dashes else "-"
                axes.plot(layer.x, layer.y, color=layer.colour, linewidth=layer.width, linestyle=style)
            case Band():
                axes.fill_between(
                    layer.x, layer.low, layer.high, color=layer.colour, alpha=layer.opacity, linewidth=layer.edge
                )
            case Dots():
                axes.plot(layer.x, layer.y, linestyle="none", marker=".", markersize=layer.size, markeredgewidth=0,
                          color=layer.colour, alpha=layer.opacity)  # fmt: skip
    axes.set_xlim(x_limits)
    if panel.y_limits:
        axes.set_ylim(panel.y_limits)
    else:
        axes.margins(y=0.08)


def _style(axes: Axes, panel: Panel, width: float, *, last: bool) -> None:
    axes.set_facecolor("none")
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(MUTED if last else RULE)
    axes.spines["bottom"].set_linewidth(0.8)
    if panel.ticks:
        axes.grid(axis="y", color=RULE, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(axis="y", length=0, pad=6, labelsize=_FONT, labelcolor=MUTED)
    axes.tick_params(axis="x", length=3 if last else 0, pad=4, labelsize=_FONT, labelcolor=MUTED, color=MUTED,
                     labelbottom=last)  # fmt: skip
    axes.xaxis.set_major_locator(MaxNLocator(9 if width > 600 else 5))
    if not panel.ticks:
        axes.set_yticks([])
    elif not panel.log_y:
        axes.yaxis.set_major_locator(MaxNLocator(panel.ticks))
        axes.yaxis.set_major_formatter(FuncFormatter(_tick))
    else:
        axes.minorticks_off()
    axes.xaxis.set_major_formatter(FuncFormatter(_tick))


def _label_width(axes: Axes) -> float:
    """Room for the tick labels of the y axis, in pixels; the system font's digits are about 0.6 of its size wide."""
    low, high = axes.get_ylim()
    ticks = [tick for tick in axes.get_yticks() if low <= tick <= high]
    longest = max((len(_tick(float(tick))) for tick in ticks), default=0)
    return max(40.0, 14 + 0.62 * _FONT * longest)


def _tick(value: float, _position: int | None = None) -> str:
    return f"{value:.6g}".replace("-", "−") if abs(value) > 1e-12 else "0"


def _lighten(svg: str, alt: str) -> str:
    """Only what draws: no document head, no style sheet of its own, no unused ids, coordinates to 0.1 pixel."""
    opening = re.search(r'<svg[^>]*viewBox="0 0 ([\d.]+) ([\d.]+)"[^>]*>', svg)
    if opening is None:
        raise ValueError("not an SVG drawing")
    width, height = (float(size) for size in opening.groups())
    body = svg[opening.end() : svg.rindex("</svg>")]
    body = re.sub(r"<metadata>.*?</metadata>|<defs>\s*<style.*?</style>\s*</defs>", "", body, flags=re.DOTALL)
    body = re.sub(r'<path d="[^"]*" style="fill: none"/>', "", body)
    body = re.sub(r' d="([^"]*)"', lambda match: f' d="{_round(match[1])}"', body)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.DOTALL)
    used = set(re.findall(r"(?:url\(#|href=\"#)([^)\"]+)", body))
    body = re.sub(r' id="([^"]+)"', lambda match: match[0] if match[1] in used else "", body)
    body = re.sub(r' transform="rotate\(-0 [^"]*"', "", body)
    body = re.sub(r"font-family:[^;\"]*;? ?", "", body)
    body = re.sub(r"(>[^<]*<)", lambda match: _subscripts(match[1]), body)
    for colour, variable in _VARIABLES.items():
        body = body.replace(colour, f"var(--{variable})")
    body = re.sub(r"(?:<g>\s*</g>|<defs>\s*</defs>)", "", re.sub(r">\s+<", "><", body))
    label = Markup.escape(alt)
    return (
        f'<svg class="plot" viewBox="0 0 {width:g} {height:g}" style="max-width:{width:.0f}px" role="img" '
        f'aria-label="{label}">{body}</svg>'
    )


def _round(path: str) -> str:
    compact = re.sub(r"-?\d+\.\d+", lambda match: f"{float(match[0]):.1f}".removesuffix(".0"), path)
    return re.sub(r"\s*([MLHVCSQTAZmlhvcsqtaz])\s*", r"\1", compact).strip()


def _subscripts(text: str) -> str:
    return re.sub(
        r"(?<![\w.])([A-Za-zΑ-ω]{1,2})_([A-Za-z0-9]{1,6})(?![\w.])",
        r'\1<tspan dy="2.5" font-size="85%">\2</tspan><tspan dy="-2.5">&#8203;</tspan>',
        text,
    )
