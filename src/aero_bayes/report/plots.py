"""Figures of the page by themselves, of a recording, a fit, a prediction or a loop: as SVG, for notebooks and files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, singledispatch
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.data.split import Role
from aero_bayes.errors import InputError
from aero_bayes.estimate.posterior import Posterior
from aero_bayes.estimate.prediction import RecordingPrediction
from aero_bayes.estimate.result import Fit
from aero_bayes.figures import Picture, draws
from aero_bayes.loop.result import LoopJson, LoopResult
from aero_bayes.plain import plain
from aero_bayes.report.curves import legend, opening_scene, recording_panels, scene_panels, stretch_words
from aero_bayes.report.drawing import Panel, draw
from aero_bayes.report.loop_figures import rounds_canvas
from aero_bayes.report.pairs import most_correlated, pair_canvas
from aero_bayes.report.results import (
    band_series,
    fitted_series,
    loop_series,
    measured_series,
    only_measured,
    recording_row,
)
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.svg import INK, MUTED, Canvas
from aero_bayes.simulation.model import Model

#: Rules of the page's style sheet that a drawing needs.
_RULES = r"(?m)(?:^|(?<=\} ))(\.(?:plot path|plot svg path|grid|base|level|tick)) (\{.*?\})"
#: Pixels that the axes of a picture are wide, and from a line of its legend to the next.
_AXES, _LINE = 720.0, 18.0


def _sheet() -> str:
    return (files("aero_bayes.report") / "templates" / "style.css.jinja").read_text("utf-8")


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
    themes = re.findall(r":root \{(.*?)\}", _sheet(), flags=re.S)
    return MappingProxyType(dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", themes[1 if dark else 0])))


def alone(canvas: Canvas, dark: bool, title: str = "", labels: Sequence[tuple[str, str]] = ()) -> str:
    """Write a drawing as a file: its title above it, its legend (colours and labels) below it, colours as numbers."""
    top = _LINE + 4 if title else 0.0
    drawing, width, height = canvas.placed(top, _AXES)
    parts = [Markup('<text x="3" y="15" font-size="13" fill="var(--{})">{}</text>').format(INK, title), drawing]
    for k, (colour, label) in enumerate(labels):  # in two columns
        x, y = 3 + 0.5 * width * (k % 2), top + height + 14 + _LINE * (k // 2)
        text = '<text x="{:g}" y="{:g}" font-size="11.5" fill="var(--{})"><tspan fill="var(--{})">━</tspan> {}</text>'
        parts.append(Markup(text).format(x, y, MUTED, colour, label))
    height += top + _LINE * -(-len(labels) // 2)
    scope = "picture-dark" if dark else "picture-light"
    style = "".join(f".{scope} {selector} {rule}" for selector, rule in re.findall(_RULES, _sheet()))
    frame = Markup(
        '<svg xmlns="http://www.w3.org/2000/svg" class="{}" width="{:g}" height="{:g}" viewBox="0 0 {:g} {:g}"'
        ' style="max-width:100%;height:auto" font-family="system-ui, Helvetica, Arial, sans-serif">'
        '<style>{}</style><rect width="100%" height="100%" fill="var(--ground)"/>{}</svg>'
    ).format(scope, width, height, width, height, Markup(style), Markup("").join(parts))
    colours = palette(dark)
    return re.sub(r"var\(--([\w-]+)\)", lambda found: colours[found[1]], frame)


def panels_picture(panels: Sequence[Panel], labels: Sequence[tuple[str, str]], title: str, dark: bool) -> Picture:
    """Draw panels one below the other over time."""
    alt = f"{title}: {', '.join(panel.title for panel in panels)}"
    return Picture(alone(draw(panels, alt, "time (s)"), dark, title, labels), tuple(panels))


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


@draws
def prediction_picture(prediction: RecordingPrediction, *, dark: bool = False) -> Picture:
    """Return a prediction with its 90 % band, over what was read if anything was."""
    name, part = prediction.recording.name, prediction.predictive
    series = band_series([name], prediction.outputs, [part])
    series |= {f"fitted/{name}/{o}": part.median[:, k] for k, o in enumerate(prediction.outputs)}
    recording = prediction.recording
    unread = {o: np.full(recording.rows, np.nan) for o in prediction.outputs if o not in recording.outputs}
    shown = view([(recording, "test")], series, prediction.model)
    shown = replace(shown, series={**series, **shown.series})
    outputs = [*(o for o in prediction.outputs if o not in unread), *unread]
    return panels_picture(recording_panels(shown, name, outputs=outputs), legend(shown, name), name, dark)


@draws
def scene_picture(found: RunDirectory | LoopResult, *, dark: bool = False) -> Picture:
    """Return the picture that a page opens with: of a loop the output that most was left of, before and after."""
    run = drawable(found)
    scene = opening_scene(run)
    if scene is None:
        raise InputError(f"{run.path}: the run has no curves to draw")
    return panels_picture(scene_panels(run, scene), legend(run, scene.recording), stretch_words(run, scene), dark)


@draws
def run_picture(
    found: RunDirectory | Recording | Fit | Posterior, recording: str | None = None, *, dark: bool = False
) -> Picture:
    """Return inputs and outputs of a recording with what the result makes of them; of the first one by default."""
    run = drawable(found)
    names = run.recordings()
    chosen = recording if recording is not None else next(iter(names), "")
    if chosen not in names:
        raise InputError(f"no recording {chosen!r} here; there are {', '.join(names) or 'none'}")
    return panels_picture(recording_panels(run, chosen), legend(run, chosen), chosen, dark)


@draws
def pairs_picture(
    draws: Mapping[str, FloatArray],
    units: Mapping[str, str],
    parameters: Sequence[str] | None = None,
    *,
    dark: bool = False,
) -> Picture:
    """Draw marginal densities, the regions that hold 50 % and 90 % of every pair, and rank correlations."""
    for name in parameters or ():
        if name not in draws:
            raise InputError(f"no draws of {name}; there are those of {', '.join(draws)}")
    names = list(parameters or most_correlated(draws))
    if not names:
        raise InputError("no parameter varies in these draws")
    return Picture(alone(pair_canvas(draws, units, names), dark))


@draws
def rounds_picture(loop: LoopResult, *, dark: bool = False) -> Picture:
    """Draw by how much the error on left-out readings falls as bars: a row for each candidate, a column for each
    step."""
    canvas = rounds_canvas(loop_json(loop), loop.words)
    if canvas is None:
        raise InputError("the loop tried no candidate, so there are no steps to draw")
    return Picture(alone(canvas, dark))
