"""A number a rig, all rigs in order: one drawing that serves twenty rigs and ten thousand.

Every rig is a point at its value and its rank, so that the points form the fleet's distribution function. Where there
are few, each has its own interval and is a link; where there are many, the picture is thinned and the page's script
finds the rig under the cursor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from aero_bayes.report.drawing import FloatArray, nice_ticks, tick_text
from aero_bayes.report.svg import ACCENT, INK, MEASURED, MUTED, RULE, WARM_COLOUR, Canvas

#: Rigs up to which each is drawn with its interval and as a link, and points that are drawn of more.
MAX_LINKED_RIGS, MAX_DRAWN_POINTS = 200, 700
_LEFT, _RIGHT, _TOP, _FOOT = 16.0, 16.0, 28.0, 40.0


@dataclass(frozen=True, eq=False)
class Ranked:
    """What is drawn.

    Parameters
    ----------
    key : str
        Of the values among the series that are put into the page.
    title, x_label : str
    names : sequence of str
        Of the rigs.
    values : ndarray, shape (n,)
        NaN for a rig that has none.
    low, high : ndarray, shape (n,), optional
        Each rig's own 90 % interval.
    shrunk : ndarray, shape (n,), optional
        Values in the light of the fleet.
    curve : tuple of ndarray, optional
        The distribution that the fleet is said to have: values and the share below.
    flagged : ndarray of bool, shape (n,)
        Rigs that stand out.
    log : bool
    level : float, optional
        A value to mark.
    """

    key: str
    title: str
    x_label: str
    names: Sequence[str]
    values: FloatArray
    flagged: NDArray[np.bool_]
    low: FloatArray | None = None
    high: FloatArray | None = None
    shrunk: FloatArray | None = None
    curve: tuple[FloatArray, FloatArray] | None = None
    log: bool = False
    level: float | None = None


@dataclass(frozen=True)
class _RankFrame:
    width: float
    height: float
    limits: tuple[float, float]
    log: bool

    def across(self, x: FloatArray) -> FloatArray:
        low, high = self.limits
        at = np.log(x) if self.log else x
        return np.asarray(_LEFT + (self.width - _LEFT - _RIGHT) * (at - low) / (high - low))

    def down(self, share: FloatArray) -> FloatArray:
        return np.asarray(_TOP + (self.height - _TOP - _FOOT) * (1.0 - share))


def ranked_drawing(shown: Ranked, width: float, alt: str) -> Markup:
    """Return the drawing, in CSS pixels at its true size; taller for few rigs that each need a line."""
    known = np.flatnonzero(np.isfinite(shown.values))
    order = known[np.argsort(shown.values[known], kind="stable")]
    count = len(order)
    height = 200.0 + _TOP + _FOOT if count > 40 else max(150.0, 9.0 * count) + _TOP + _FOOT
    frame = _RankFrame(width, height, _limits(shown, order), shown.log)
    share = (np.arange(count) + 0.5) / max(count, 1)
    canvas = Canvas(width, height, alt)
    box = [_LEFT, _TOP, width - _LEFT - _RIGHT, height - _TOP - _FOOT]
    canvas.group("ranked", {"k": shown.key, "box": box, "x": frame.limits, "log": int(shown.log)})
    canvas.text(3, 14, shown.title, INK, 12)
    _axis(canvas, frame, shown.x_label, 8 if width > 600 else 5)
    if shown.level is not None:
        at = frame.across(np.array([shown.level, shown.level]))
        canvas.curve(at, [_TOP, height - _FOOT], MUTED, 0.9, "4 3")
    canvas.clip(_LEFT - 6, _TOP - 6, width - _LEFT - _RIGHT + 12, height - _TOP - _FOOT + 10)
    if shown.curve is not None:
        canvas.curve(frame.across(shown.curve[0]), frame.down(shown.curve[1]), MUTED, 1.2, "5 3")
    _points(canvas, shown, frame, order, share)
    canvas.end()
    canvas.end()
    return canvas.svg()


def _limits(shown: Ranked, order: NDArray[np.intp]) -> tuple[float, float]:
    parts = [shown.values[order]]
    if len(order) <= MAX_LINKED_RIGS and shown.low is not None and shown.high is not None:
        parts += [shown.low[order], shown.high[order]]
    if shown.level is not None:
        parts.append(np.array([shown.level]))
    values = np.concatenate(parts)
    values = np.log(values[values > 0.0]) if shown.log else values
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    spare = 0.04 * (high - low) or 0.1 * abs(high) or 1.0
    return low - spare, high + spare


def _axis(canvas: Canvas, frame: _RankFrame, label: str, most: int) -> None:
    foot, right = frame.height - _FOOT, frame.width - _RIGHT
    canvas.curve([_LEFT, right], [foot, foot], MUTED, 0.8)
    low, high = (math.exp(end) if frame.log else end for end in frame.limits)
    ticks = nice_ticks(low, high, most) if not frame.log or high / low < 5.0 else _log_ticks(low, high, most)
    for tick, x in zip(ticks, frame.across(np.array(ticks)).tolist(), strict=True):
        canvas.curve([x, x], [_TOP, foot], RULE, 0.8)
        canvas.text(x, foot + 15, tick_text(tick), MUTED, 11.5, "middle")
    canvas.text(0.5 * (_LEFT + right), foot + 33, label, MUTED, 11.5, "middle")


def _log_ticks(low: float, high: float, most: int) -> list[float]:
    """Round values a decade: 1, 2, 5 where there is room, else powers of ten."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for factors in ((1, 2, 5), (1, 3), (1,)):
        ticks = [f * 10.0**d for d in decades for f in factors if low <= f * 10.0**d <= high]
        if len(ticks) <= most:
            return ticks
    return ticks[:: math.ceil(len(ticks) / most)]


def _points(canvas: Canvas, shown: Ranked, frame: _RankFrame, order: NDArray[np.intp], share: FloatArray) -> None:
    few = len(order) <= MAX_LINKED_RIGS
    drawn = np.arange(len(order))
    if not few:
        kept = np.unique(np.linspace(0, len(order) - 1, MAX_DRAWN_POINTS).astype(np.intp))
        drawn = np.union1d(kept, np.flatnonzero(shown.flagged[order]))
    rows, y = order[drawn], frame.down(share[drawn])
    x = frame.across(shown.values[rows])
    if few and shown.low is not None and shown.high is not None:
        for k, at in zip(rows.tolist(), y.tolist(), strict=True):
            canvas.curve(frame.across(np.array([shown.low[k], shown.high[k]])), [at, at], MEASURED, 1.1)
    if few and shown.shrunk is not None:
        canvas.dots(frame.across(shown.shrunk[rows]), y, MUTED, 3.0, 0.9)
    plain, odd = ~shown.flagged[rows], shown.flagged[rows]
    size = 5.0 if few else 2.4
    if few:
        _linked(canvas, shown.names, rows, x, y)
    canvas.dots(x[plain], y[plain], ACCENT, size, 0.9 if few else 0.7)
    canvas.dots(x[odd], y[odd], WARM_COLOUR, size + 1.4, 1.0)


def _linked(canvas: Canvas, names: Sequence[str], rows: NDArray[np.intp], x: FloatArray, y: FloatArray) -> None:
    """A wide transparent point a rig, which is a link to its own page."""
    for k, a, b in zip(rows.tolist(), x.tolist(), y.tolist(), strict=True):
        canvas.link(rig_page(names[k]), names[k], a, b, 9.0)


def rig_page(name: str) -> str:
    """Return address of a rig's own page, from the fleet's."""
    return f"rigs/{name}/report.html"
