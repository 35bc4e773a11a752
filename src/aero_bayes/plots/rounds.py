"""The steps of a closed loop: by how much each candidate lowers the left-out error, and what was chosen."""

from __future__ import annotations

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aero_bayes.errors import InputError
from aero_bayes.loop.result import LoopResult
from aero_bayes.plots.figure import WIDTH, ground
from aero_bayes.plots.style import palette, settings
from aero_bayes.plots.view import loop_json
from aero_bayes.report.loop_figures import fall, fall_text, rounds, short_label


def rounds_figure(loop: LoopResult, *, figure: Figure | Axes | None = None, dark: bool = False) -> Figure:
    """Draw by how much the error on left-out readings falls as bars: a row for each candidate, a
    column for each step."""
    steps, _, ids = rounds(loop_json(loop))
    if not steps:
        raise InputError("the loop tried no candidate, so there are no steps to draw")
    colours = palette(dark)
    with matplotlib.rc_context(settings(colours) | {"axes.grid": False}):
        figure = ground(figure, WIDTH, 1.1 + 0.24 * len(ids), dark)
        grid = figure.subplots(1, len(steps), sharey=True, squeeze=False)[0]
        for axes, step in zip(grid, steps, strict=True):
            found = {c.id: c for c in step.candidates}
            for row, id_ in enumerate(ids):
                candidate = found.get(id_)
                if candidate is None or candidate.share is None:
                    continue
                chosen = id_ == step.chosen
                length = max(fall(candidate), 0.0)
                edge = colours["ink"] if id_ in step.equivalent else "none"
                axes.barh(row, length, 0.62, color=colours["warm" if chosen else "measured"], edgecolor=edge)
                label = f" {fall_text(candidate)}"
                axes.text(length, row, label, va="center", fontsize=7.5, color=colours["ink" if chosen else "muted"])
            axes.set_xlim(0, 130)
            axes.set_xticks(range(0, 101, 25))
            axes.set_title(f"step {step.round}: {step.chosen or 'nothing'} chosen", color=colours["ink"])
            axes.set_xlabel("fall of the left-out error (%)")
        grid[0].set_yticks(range(len(ids)), [short_label(id_, loop.words) for id_ in ids])
        grid[0].invert_yaxis()
    return figure
