"""Panels drawn with matplotlib: the same descriptions from which the page draws its own figures."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from typing import cast

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.plots.style import mathematics, palette, settings
from aero_bayes.report.drawing import Band, Dots, Line, Panel
from aero_bayes.report.thinning import band_envelope, column_means

__all__ = ["FloatArray", "Picture", "draw_panels", "ground"]

#: Width of a figure in inches, inches for each pixel of a panel's height, and time columns of a cloud.
WIDTH, INCHES, COLUMN_COUNT = 8.2, 0.0115, 900


class Picture(Figure):
    """A figure that notebooks show by itself. It belongs to no window: use ``savefig``, or hand in a figure."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=110)
        return stream.getvalue()


def ground(figure: Figure | Axes | None, width: float, height: float, dark: bool) -> Figure:
    """Return what is drawn into: a figure, the place of an axes in one, or a new figure of a size in inches."""
    if isinstance(figure, Axes):
        place, whole = figure.get_subplotspec(), figure.figure
        if place is None:
            raise InputError("ax: expected one of a grid, as matplotlib.pyplot.subplots gives them")
        figure.remove()
        return cast(Figure, whole.add_subfigure(place))
    if figure is not None:
        return figure
    colours = palette(dark)
    return Picture(figsize=(width, height), layout="constrained", facecolor=colours["ground"])


def draw_panels(
    panels: Sequence[Panel],
    x_label: str,
    legend: Sequence[tuple[str, str]] = (),
    *,
    title: str = "",
    figure: Figure | Axes | None = None,
    dark: bool = False,
) -> Figure:
    """Draw panels one below the other over a common x axis."""
    colours = palette(dark)
    with matplotlib.rc_context(settings(colours)):
        height = 0.9 + sum(INCHES * panel.height + 0.32 for panel in panels)
        figure = ground(figure, WIDTH, height, dark)
        heights = [panel.height for panel in panels]
        grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights})
        for axes, panel in zip(grid[:, 0], panels, strict=True):
            _draw(axes, panel, colours)
        grid[-1, 0].set_xlabel(x_label)
        limits = next((panel.x_limits for panel in panels if panel.x_limits), None)
        grid[-1, 0].set_xlim(*(limits or _reach(panels)))
        figure.align_ylabels(grid[:, 0])
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=10.5)
        if legend:
            handles = [_key(colours[c], words) for c, words in legend]
            figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))
    return figure


def _key(colour: str, words: str) -> Artist:
    """Return what a legend shows for a curve, or for a band."""
    if words.startswith("shaded"):
        return Patch(color=colour, alpha=0.3, linewidth=0, label=words)
    return Line2D([], [], color=colour, linewidth=3, label=words)


def _reach(panels: Sequence[Panel]) -> tuple[float, float]:
    ends = [(float(np.min(layer.x)), float(np.max(layer.x))) for panel in panels for layer in panel.layers]
    return min(low for low, _ in ends), max(high for _, high in ends)


def _draw(axes: Axes, panel: Panel, colours: Mapping[str, str]) -> None:
    unit = re.search(r"\(([^()]*)\)$", panel.title)
    axes.set_title(mathematics(panel.title), color=colours["ink"])
    axes.set_ylabel(unit[1] if unit else "")
    for layer in panel.layers:
        colour = colours[layer.colour]
        match layer:
            case Line():
                _line(axes, layer, colour)
            case Band():
                axes.fill_between(layer.x, layer.low, layer.high, color=colour, alpha=layer.opacity, linewidth=0)
            case Dots():
                low, high = axes.get_ylim() if layer.source else (-np.inf, np.inf)
                size = layer.size if layer.source else 2 * layer.size
                axes.plot(layer.x, np.clip(layer.y, low, high), ".", color=colour, markersize=size, alpha=layer.opacity)
    for level in panel.levels:
        axes.axhline(level, color=colours["muted"], linewidth=0.8, dashes=(4, 3))
    if panel.y_limits:
        axes.set_ylim(*panel.y_limits)
    if panel.log_y:
        axes.set_yscale("log")
    else:
        axes.locator_params(axis="y", nbins=max(panel.ticks, 2))


def _line(axes: Axes, layer: Line, colour: str) -> None:
    if layer.cloud and len(layer.x) > 4 * COLUMN_COUNT:
        at, low, high = band_envelope(layer.x, layer.y, layer.y, COLUMN_COUNT)
        axes.fill_between(at, low, high, color=colour, alpha=layer.cloud, linewidth=0.5)
        if layer.trend:
            axes.plot(*column_means(layer.x, layer.y, COLUMN_COUNT // 4), color=colour, linewidth=1.4)
        return
    style = "steps-post" if layer.held else "default"
    width = 0.8 * layer.width
    axes.plot(layer.x, layer.y, color=colour, linewidth=width, drawstyle=style, linestyle="--" if layer.dashes else "-")
