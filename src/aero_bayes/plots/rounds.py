"""The steps of a closed loop: what each candidate would gain, and what was chosen."""

from __future__ import annotations

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aero_bayes.errors import InputError
from aero_bayes.loop.result import LoopResult
from aero_bayes.plots.figure import WIDTH, ground
from aero_bayes.plots.style import palette, settings
from aero_bayes.plots.view import loop_json
from aero_bayes.report.loop_figures import gain_text, rounds, short_label


def rounds_figure(loop: LoopResult, *, figure: Figure | Axes | None = None, dark: bool = False) -> Figure:
    """Draw the gain in log-evidence as bars: a row for each candidate, a column for each step.

    Raises
    ------
    InputError
        If the loop tried nothing.
    """
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
                if candidate is None or candidate.delta_evidence is None:
                    continue
                chosen = id_ == step.chosen
                gain = max(candidate.delta_evidence, 0.0)
                edge = colours["ink"] if id_ in step.equivalent else "none"
                axes.barh(row, gain, 0.62, color=colours["warm" if chosen else "measured"], edgecolor=edge)
                label = f" {gain_text(candidate.delta_evidence)}"
                axes.text(gain, row, label, va="center", fontsize=7.5, color=colours["ink" if chosen else "muted"])
            if step.threshold is not None:
                axes.axvline(step.threshold, color=colours["muted"], linewidth=0.8, dashes=(4, 3))
            axes.set_xscale("symlog", linthresh=10.0)
            axes.set_xlim(0, 12.0 * max([10.0, *(c.delta_evidence or 0.0 for c in step.candidates)]))
            axes.set_title(f"step {step.round}: {step.chosen or 'nothing'} chosen", color=colours["ink"])
            axes.set_xlabel("gain in log-evidence (nats)")
        grid[0].set_yticks(range(len(ids)), [short_label(id_, loop.words) for id_ in ids])
        grid[0].invert_yaxis()
    return figure
