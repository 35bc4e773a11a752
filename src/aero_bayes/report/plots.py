"""Figures of a recording, a fit, a prediction or a loop, for notebooks and the page."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, singledispatch
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.data.split import Role
from aero_bayes.errors import InputError
from aero_bayes.estimate.prediction import RecordingPrediction
from aero_bayes.estimate.result import Fit
from aero_bayes.figures import draws
from aero_bayes.loop.result import LoopResult
from aero_bayes.plain import plain
from aero_bayes.posterior.posterior import Posterior
from aero_bayes.report.curves import legend, opening_scene, recording_panels, scene_panels, stretch_words
from aero_bayes.report.drawing import Band, Dots, Line, Panel, band_envelope, column_means, limits_of_x
from aero_bayes.report.loop_figures import fall, fall_text, rounds, short_label
from aero_bayes.report.results import (
    band_series,
    fitted_series,
    loop_series,
    measured_series,
    only_measured,
    recording_row,
)
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_run import LoopJson, RunJson
from aero_bayes.simulation.model import Model


@cache
def palette(dark: bool = False) -> Mapping[str, str]:
    """Return colours by the names that figures draw with, as the page has them on a light or a dark ground.

    Parameters
    ----------
    dark : bool

    Returns
    -------
    mapping of str to str
        ``ground``, ``ink``, ``muted``, ``rule``, ``measured``, ``accent``, ``warm`` and ``s1`` to ``s6`` (after Okabe
        and Ito, 2008: told apart by colour-blind readers), each as ``#rrggbb``.

    Examples
    --------
    >>> from aero_bayes.report.plots import palette
    >>> palette()["accent"], palette(dark=True)["ground"]
    ('#0067a8', '#11161b')
    """
    sheet = files("aero_bayes.report") / "templates" / "style.css.jinja"
    themes = re.findall(r":root \{(.*?)\}", sheet.read_text("utf-8"), flags=re.S)
    return MappingProxyType(dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", themes[1 if dark else 0])))


def settings(colours: Mapping[str, str]) -> dict[Any, Any]:
    """Return matplotlib's settings for one figure; they are not set for others."""
    return {
        "font.size": 9.0,
        "text.color": colours["ink"],
        "axes.titlesize": 9.5,
        "axes.titlelocation": "left",
        "axes.labelcolor": colours["muted"],
        "axes.edgecolor": colours["muted"],
        "axes.facecolor": colours["ground"],
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.grid.axis": "y",
        "axes.axisbelow": True,
        "grid.color": colours["rule"],
        "grid.linewidth": 0.7,
        "xtick.color": colours["muted"],
        "ytick.color": colours["muted"],
        "legend.frameon": False,
        "figure.facecolor": colours["ground"],
        "savefig.facecolor": colours["ground"],
        "path.simplify": True,
    }


def mathematics(words: str) -> str:
    """Write ``R_a`` with a subscript, as matplotlib sets it."""
    escaped = words.replace("$", r"\$")
    return re.sub(r"(?<![\w.])([A-Za-zΑ-ω]{1,2})_([A-Za-z0-9]{1,6})(?![\w.])", r"$\\mathrm{\1_{\2}}$", escaped)


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
        grid[-1, 0].set_xlim(*limits_of_x(panels))
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
                low, high = axes.get_ylim() if layer.at_edge else (-np.inf, np.inf)
                size = layer.size if layer.at_edge else 2 * layer.size
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


def view(
    recordings: Sequence[tuple[Recording, Role]],
    series: Mapping[str, FloatArray],
    model: Model | None = None,
    **result: object,
) -> RunDirectory:
    """Return a run directory that is on no disk; ``result`` are further keys of result.json."""
    variables = (*model.inputs, *model.states, *model.outputs) if model is not None else ()
    described = {v.name: {"unit": v.unit, "description": v.description} for v in variables}
    units = {name: unit for recording, _ in recordings for name, unit in recording.units.items()}
    rows = [recording_row(recording, role) for recording, role in recordings]
    found = RunJson.model_validate({"units": units, "signals": described, "recordings": rows, **result})
    measured = measured_series([recording for recording, _ in recordings])
    return RunDirectory(Path(), found, only_measured({**measured, **series}), {})


@singledispatch
def drawable(found: Any) -> RunDirectory:
    """Return a recording, a fit, a posterior or a loop with its curves, as a run that is on no disk."""
    assert isinstance(found, RunDirectory)
    return found


@drawable.register
def _(recording: Recording) -> RunDirectory:
    return view([(recording, "train")], {})


@drawable.register
def _(fit: Fit) -> RunDirectory:
    recordings = fit.calibration.data.recordings
    if not recordings:
        raise InputError("a fit to experiments without recordings has nothing to be drawn over")
    return view([(r, "train") for r in recordings], fitted_series(fit), fit.calibration.model)


@drawable.register
def _(posterior: Posterior) -> RunDirectory:
    base = drawable(posterior.fit)
    series = band_series(posterior.calibration.data.names, posterior.fit.outputs, posterior.predictive)
    return replace(base, series=only_measured({**base.series, **series}))


@drawable.register
def _(loop: LoopResult) -> RunDirectory:
    given = loop.recordings
    roles: list[tuple[Recording, Role]] = [(r, "train") for r in given.train]
    roles += [(r, "validation") for r in given.validation] + [(r, "test") for r in given.test]
    told = {"command": "close-loop", "loop": loop_json(loop), "words": dict(loop.words)}
    return view(roles, loop_series(loop), loop.first.plain.model, **told)


def loop_json(loop: LoopResult) -> LoopJson:
    """Return a closed loop as result.json has it."""
    return LoopJson.model_validate(plain(loop.to_dict()))


TIME = "time (s)"


@draws
def prediction_figure(
    prediction: RecordingPrediction, *, figure: Figure | Axes | None = None, dark: bool = False
) -> Figure:
    """Return a prediction with its 90 % band, over what was read if anything was."""
    name, part = prediction.recording.name, prediction.predictive
    series = band_series([name], prediction.outputs, [part])
    series |= {f"fitted/{name}/{o}": part.median[:, k] for k, o in enumerate(prediction.outputs)}
    recording = prediction.recording
    unread = {o: np.full(recording.rows, np.nan) for o in prediction.outputs if o not in recording.outputs}
    shown = view([(recording, "test")], series, prediction.model)
    shown = replace(shown, series={**series, **shown.series})
    read = [o for o in prediction.outputs if o not in unread]
    return _figure(shown, name, [*read, *unread], figure, dark)


@draws
def scene_figure(
    found: RunDirectory | LoopResult, *, figure: Figure | Axes | None = None, dark: bool = False
) -> Figure:
    """Return the picture that a page opens with: of a loop the output that most was left of, before and after."""
    run = drawable(found)
    scene = opening_scene(run)
    if scene is None:
        raise InputError(f"{run.path}: the run has no curves to draw")
    words = legend(run, scene.recording)
    return draw_panels(scene_panels(run, scene), TIME, words, title=stretch_words(run, scene), figure=figure, dark=dark)


@draws
def run_figure(
    found: RunDirectory | Recording | Fit | Posterior,
    recording: str | None = None,
    *,
    figure: Figure | Axes | None = None,
    dark: bool = False,
) -> Figure:
    """Return inputs and outputs of a recording with what the result makes of them; of the first one by default."""
    run = drawable(found)
    names = run.recordings()
    chosen = recording if recording is not None else next(iter(names), "")
    if chosen not in names:
        raise InputError(f"no recording {chosen!r} here; there are {', '.join(names) or 'none'}")
    return _figure(run, chosen, None, figure, dark)


def _figure(
    run: RunDirectory, name: str, outputs: list[str] | None, figure: Figure | Axes | None, dark: bool
) -> Figure:
    panels = recording_panels(run, name, outputs=outputs)
    return draw_panels(panels, TIME, legend(run, name), title=name, figure=figure, dark=dark)


@draws
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
                if candidate is None or not math.isfinite(candidate.share):
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
