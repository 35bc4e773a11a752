"""How the parameters of a posterior hang together: marginals on the diagonal, regions below, correlations above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.report.plots import ground, mathematics, palette, settings
from aero_bayes.report.posterior_figures import marginal, most_correlated, rank_correlation, regions, rim, span
from aero_bayes.report.text import greek_name, minus, pretty_unit


def pairs_figure(
    draws: Mapping[str, FloatArray],
    units: Mapping[str, str],
    parameters: Sequence[str] | None = None,
    *,
    figure: Figure | Axes | None = None,
    dark: bool = False,
) -> Figure:
    """Draw marginal densities, the regions that hold 50 % and 90 % of every pair, and rank correlations."""
    for name in parameters or ():
        if name not in draws:
            raise InputError(f"no draws of {name}; there are those of {', '.join(draws)}")
    names = list(parameters or most_correlated(draws))
    if not names:
        raise InputError("no parameter varies in these draws")
    flat = {name: draws[name].ravel() for name in names}
    correlation = np.atleast_2d(rank_correlation(flat, names))
    colours = palette(dark)
    with matplotlib.rc_context(settings(colours) | {"axes.grid": False, "font.size": 8.0}):
        size = max(3.2, min(8.2, 1.7 * len(names)))
        figure = ground(figure, size, size, dark)
        grid = figure.subplots(len(names), len(names), squeeze=False, sharex="col")
        for row, below in enumerate(names):
            for column, name in enumerate(names):
                axes = grid[row, column]
                if row == column:
                    _marginal(axes, flat[name], colours)
                elif row > column:
                    _region(axes, flat[name], flat[below], colours)
                else:
                    _number(axes, correlation[row, column], colours)
                    continue
                axes.locator_params(nbins=3)
                axes.tick_params(labelbottom=row == len(names) - 1, labelleft=row > column == 0)
                if row == len(names) - 1:
                    axes.set_xlabel(_label(name, units))
                if column == 0 and row > 0:
                    axes.set_ylabel(_label(below, units))
    return figure


def _label(name: str, units: Mapping[str, str]) -> str:
    unit = pretty_unit(units.get(name, ""))
    return mathematics(f"{greek_name(name)} ({unit})" if unit else greek_name(name))


def _marginal(axes: Axes, draws: FloatArray, colours: Mapping[str, str]) -> None:
    height = marginal(draws)
    at = np.linspace(*span(draws), len(height))
    axes.fill_between(at, 0, height, color=colours["accent"], alpha=0.35, linewidth=0)
    axes.plot(at, height, color=colours["accent"], linewidth=1.0)
    axes.set_ylim(0, 1.08)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def _region(axes: Axes, across: FloatArray, up: FloatArray, colours: Mapping[str, str]) -> None:
    density, (outer, inner) = regions(across, up)
    x, y = (low + rim() * (high - low) for low, high in (span(across), span(up)))
    for level, opacity in ((outer, 0.25), (inner, 0.5)):
        axes.contourf(x, y, density, [level, np.inf], colors=[colours["accent"]], alpha=opacity)


def _number(axes: Axes, correlation: float, colours: Mapping[str, str]) -> None:
    strength = abs(correlation)
    colour = colours["ink" if strength >= 0.5 else "muted"]
    text = minus(f"{correlation:+.2f}")
    axes.text(0.5, 0.5, text, ha="center", va="center", color=colour, fontsize=8 + 6 * strength,
              transform=axes.transAxes)  # fmt: skip
    axes.set_axis_off()
