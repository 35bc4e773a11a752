"""How the parameters of a posterior hang together: marginals on the diagonal, regions below, correlations above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast

import contourpy
import numpy as np
import scipy  # imports its parts when they are first used
from markupsafe import Markup
from scipy.ndimage import gaussian_filter

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.figures import draws
from aero_bayes.report.drawing import Plate
from aero_bayes.report.svg import ACCENT, INK, MUTED, RULE, Canvas
from aero_bayes.report.tables import html_table
from aero_bayes.report.text import greek_name, minus, pretty_unit, rounded_value, symbol

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def most_correlated(posterior: Mapping[str, FloatArray], most: int = 8) -> list[str]:
    """Return names of at most ``most`` parameters that vary, those in the strongest rank correlations first."""
    names = [name for name, draws in posterior.items() if np.isfinite(draws).all() and np.ptp(draws) > 0]
    if len(names) < 2:
        return names
    correlation = np.abs(rank_correlation(posterior, names))
    np.fill_diagonal(correlation, 0)
    order = np.argsort(-correlation.max(axis=1), kind="stable")[:most]
    kept = [names[index] for index in order]
    return [name for name in names if name in kept]


def pair_plate(posterior: Mapping[str, FloatArray], units: Mapping[str, str]) -> Plate | None:
    """Draw marginal densities on the diagonal, 50 % and 90 % regions of every pair below it."""
    names = most_correlated(posterior)
    if len(names) < 2:
        return None
    draws = {name: posterior[name].ravel() for name in names}
    correlation = rank_correlation(posterior, names)
    cell = min(150.0, 980.0 / len(names))
    first, second, value = _strongest(names, correlation)
    alt = f"Pair plot of {len(names)} parameters. Strongest rank correlation: {first} with {second}, {value}."
    canvas = Canvas(cell * len(names) + 8, cell * len(names) + 62, alt)
    for row, below in enumerate(names):
        for column, name in enumerate(names[: row + 1]):
            corner = 2 + cell * column, 22 + cell * row
            if row == column:
                _marginal(canvas, draws[name], *corner, cell)
                canvas.text(corner[0] + cell / 2 - 4, corner[1] - 4, greek_name(name), INK, 12.5, "middle")
            else:
                _joint(canvas, draws[name], draws[below], *corner, cell)
                _number(canvas, correlation[row, column], 2 + cell * row, 22 + cell * column, cell)
    for column, name in enumerate(names):
        _cell_scale(canvas, draws[name], units.get(name, ""), 2 + cell * column, 22 + cell * len(names), cell)
    caption = Markup(
        "Inner and outer regions hold 50 % and 90 % of the posterior. Numbers: rank correlations. "
        "Each cell spans the central 99.8 % of its parameter. Strongest correlation: {} with {}, {}."
    ).format(symbol(first), symbol(second), value)
    rows = [
        (symbol(name), *(minus(f"{correlation[row, column]:+.2f}") for column in range(len(names))))
        for row, name in enumerate(names)
    ]
    table = html_table(("", *(symbol(name) for name in names)), rows, "Rank correlations")
    return Plate(canvas.svg(), alt, caption, table, scrolls=True)


def rank_correlation(posterior: Mapping[str, FloatArray], names: Sequence[str]) -> FloatArray:
    """Rank correlations of parameters, shape (p, p)."""
    ranks = np.array([scipy.stats.rankdata(posterior[name]) for name in names], dtype=np.float64)
    return np.asarray(np.corrcoef(ranks), dtype=np.float64)


def _strongest(names: Sequence[str], correlation: FloatArray) -> tuple[str, str, str]:
    lower = np.tril(correlation, -1)
    row, column = np.unravel_index(np.argmax(np.abs(lower)), lower.shape)
    return names[int(column)], names[int(row)], minus(f"{lower[row, column]:+.2f}")


def span(draws: FloatArray) -> tuple[float, float]:
    """Return the central 99.8 % of draws."""
    low, high = (float(q) for q in np.quantile(draws, (0.001, 0.999)))
    return low, high if high > low else low + 1e-12


def _marginal(canvas: Canvas, draws: FloatArray, left: float, top: float, cell: float) -> None:
    side = cell - 8
    height = marginal(draws)
    x, foot = left + np.linspace(0, side, len(height)), top + side
    canvas.area(x, np.full(len(height), foot), foot - 0.9 * side * height, ACCENT, 0.35, 0)
    canvas.curve([left, left + side], [foot, foot], MUTED, 0.8)


def regions(across: FloatArray, up: FloatArray, bins: int = 44) -> tuple[FloatArray, tuple[float, float]]:
    """Compute the smoothed density of draws over their ranges, and the levels within which 90 % and 50 % of them lie.

    Its shape is (bins + 2, bins + 2), with an empty rim."""
    counts, _, _ = np.histogram2d(up, across, bins=bins, range=(span(up), span(across)))
    smooth = np.pad(gaussian_filter(counts, 2.0, mode="nearest"), 1)
    ranked = np.sort(smooth.ravel())[::-1]
    held = np.cumsum(ranked) / ranked.sum()
    outer, inner = (float(ranked[min(int(np.searchsorted(held, s)), len(ranked) - 1)]) for s in (0.9, 0.5))
    return smooth, (outer, inner)


def rim(bins: int = 44) -> FloatArray:
    """Return where the rows and columns of :func:`regions` lie, as shares of the range."""
    return np.clip((np.arange(-1, bins + 1) + 0.5) / bins, 0, 1)


def marginal(draws: FloatArray, bins: int = 40) -> FloatArray:
    """Compute the smoothed histogram of draws over their range, shape (bins,), 1 at its peak."""
    counts, _ = np.histogram(draws, bins=bins, range=span(draws))
    smooth = gaussian_filter(counts.astype(np.float64), 1.2, mode="nearest")
    return np.asarray(smooth / smooth.max(), dtype=np.float64)


def _joint(canvas: Canvas, across: FloatArray, up: FloatArray, left: float, top: float, cell: float) -> None:
    side = cell - 8
    smooth, levels = regions(across, up)
    grid = rim() * side
    contours = contourpy.contour_generator(left + grid, top + side - grid, smooth)
    canvas.curve([left, left, left + side], [top, top + side, top + side], RULE, 0.8)
    for level, opacity in zip(levels, (0.25, 0.5), strict=True):
        canvas.regions(cast("list[FloatArray]", contours.lines(level)), ACCENT, opacity)


def _number(canvas: Canvas, correlation: float, left: float, top: float, cell: float) -> None:
    """Write the rank correlation in the mirrored cell: the stronger, the larger and darker."""
    strength = abs(correlation)
    colour = INK if strength >= 0.5 else MUTED
    text = minus(f"{correlation:+.2f}")
    canvas.text(left + cell / 2 - 4, top + cell / 2 + 2, text, colour, 11 + 9 * strength, "middle")


def _cell_scale(canvas: Canvas, draws: FloatArray, unit: str, left: float, foot: float, cell: float) -> None:
    low, high = span(draws)
    shown = rounded_value(0.5 * (low + high), low, high, unit, digits=1)
    canvas.text(left, foot + 7, shown.low, MUTED, 10.5)
    canvas.text(left + cell - 8, foot + 7, shown.high, MUTED, 10.5, "end")
    canvas.text(left + (cell - 8) / 2, foot + 24, shown.unit, MUTED, 10.5, "middle")


@draws
def pairs_figure(
    draws: Mapping[str, FloatArray],
    units: Mapping[str, str],
    parameters: Sequence[str] | None = None,
    *,
    figure: Figure | Axes | None = None,
    dark: bool = False,
) -> Figure:
    """Draw marginal densities, the regions that hold 50 % and 90 % of every pair, and rank correlations."""
    import matplotlib

    from aero_bayes.report.plots import ground, mathematics, palette, settings

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
                    _marginal_axes(axes, flat[name], colours)
                elif row > column:
                    _region_axes(axes, flat[name], flat[below], colours)
                else:
                    _number_axes(axes, correlation[row, column], colours)
                    continue
                axes.locator_params(nbins=3)
                axes.tick_params(labelbottom=row == len(names) - 1, labelleft=row > column == 0)
                if row == len(names) - 1:
                    axes.set_xlabel(mathematics(_label(name, units)))
                if column == 0 and row > 0:
                    axes.set_ylabel(mathematics(_label(below, units)))
    return figure


def _label(name: str, units: Mapping[str, str]) -> str:
    unit = pretty_unit(units.get(name, ""))
    return f"{greek_name(name)} ({unit})" if unit else greek_name(name)


def _marginal_axes(axes: Axes, draws: FloatArray, colours: Mapping[str, str]) -> None:
    height = marginal(draws)
    at = np.linspace(*span(draws), len(height))
    axes.fill_between(at, 0, height, color=colours["accent"], alpha=0.35, linewidth=0)
    axes.plot(at, height, color=colours["accent"], linewidth=1.0)
    axes.set_ylim(0, 1.08)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def _region_axes(axes: Axes, across: FloatArray, up: FloatArray, colours: Mapping[str, str]) -> None:
    density, (outer, inner) = regions(across, up)
    x, y = (low + rim() * (high - low) for low, high in (span(across), span(up)))
    for level, opacity in ((outer, 0.25), (inner, 0.5)):
        axes.contourf(x, y, density, [level, np.inf], colors=[colours["accent"]], alpha=opacity)


def _number_axes(axes: Axes, correlation: float, colours: Mapping[str, str]) -> None:
    strength = abs(correlation)
    colour = colours["ink" if strength >= 0.5 else "muted"]
    text = minus(f"{correlation:+.2f}")
    axes.text(0.5, 0.5, text, ha="center", va="center", color=colour, fontsize=8 + 6 * strength,
              transform=axes.transAxes)  # fmt: skip
    axes.set_axis_off()
