"""How the parameters of a posterior hang together: marginals on the diagonal, regions below, correlations above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import contourpy
import numpy as np
import scipy  # imports its parts when they are first used
from markupsafe import Markup
from scipy.ndimage import gaussian_filter

from aero_bayes.arrays import FloatArray
from aero_bayes.report.drawing import Plate
from aero_bayes.report.svg import ACCENT, INK, MUTED, RULE, Canvas
from aero_bayes.report.tables import html_table
from aero_bayes.report.text import greek_name, minus, rounded_value, symbol


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
    correlation = rank_correlation(posterior, names)
    first, second, value = _strongest(names, correlation)
    canvas = pair_canvas(posterior, units, names)
    caption = Markup(
        "Inner and outer regions hold 50 % and 90 % of the posterior. Numbers: rank correlations. "
        "Each cell spans the central 99.8 % of its parameter. Strongest correlation: {} with {}, {}."
    ).format(symbol(first), symbol(second), value)
    rows = [
        (symbol(name), *(minus(f"{correlation[row, column]:+.2f}") for column in range(len(names))))
        for row, name in enumerate(names)
    ]
    table = html_table(("", *(symbol(name) for name in names)), rows, "Rank correlations")
    return Plate(canvas.svg(), canvas.alt, caption, table, scrolls=True)


def pair_canvas(posterior: Mapping[str, FloatArray], units: Mapping[str, str], names: Sequence[str]) -> Canvas:
    """Draw the cells of these parameters, at least one."""
    draws = {name: posterior[name].ravel() for name in names}
    correlation = np.atleast_2d(rank_correlation(draws, names))
    cell = min(150.0, 980.0 / len(names))
    alt = f"Pair plot of {len(names)} parameters. Strongest rank correlation: {{}} with {{}}, {{}}."
    alt = alt.format(*_strongest(names, correlation)) if len(names) > 1 else f"Marginal density of {names[0]}."
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
    return canvas


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
