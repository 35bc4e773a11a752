"""Figures over time: what was measured, what a model gives, and what it leaves."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate.prediction import RecordingPrediction
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.result import LoopResult
from aero_bayes.plots.figure import draw_panels
from aero_bayes.plots.view import fit_view, loop_view, posterior_view, view
from aero_bayes.report.curves import legend, opening_scene, recording_panels, scene_panels, stretch_words
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.sampling.posterior import Posterior
from aero_bayes.workflow.curves import band_series

TIME = "time (s)"


def recording_figure(recording: Recording, *, figure: Figure | Axes | None = None, dark: bool = False) -> Figure:
    """Return inputs and outputs of a recording."""
    return run_figure(view([(recording, "train")], {}), recording.name, figure=figure, dark=dark)


def fit_figure(
    fit: Fit, recording: str | None = None, *, figure: Figure | Axes | None = None, dark: bool = False
) -> Figure:
    """Return a recording, what the fit makes of it, and what is left."""
    return run_figure(fit_view(fit), recording, figure=figure, dark=dark)


def bands_figure(
    posterior: Posterior, recording: str | None = None, *, figure: Figure | Axes | None = None, dark: bool = False
) -> Figure:
    """Return a recording within the posterior's 90 % band of new readings."""
    return run_figure(posterior_view(posterior), recording, figure=figure, dark=dark)


def prediction_figure(
    prediction: RecordingPrediction, *, figure: Figure | Axes | None = None, dark: bool = False
) -> Figure:
    """Return a prediction with its 90 % band, over what was read if anything was."""
    name, part = prediction.recording.name, prediction.predictive
    series = band_series([name], prediction.outputs, [part.lower], [part.upper])
    series |= {f"fitted/{name}/{o}": part.median[:, k] for k, o in enumerate(prediction.outputs)}
    recording = prediction.recording
    unread = {o: np.full(recording.rows, np.nan) for o in prediction.outputs if o not in recording.outputs}
    shown = view([(recording, "test")], series, prediction.model)
    shown = RunDirectory(shown.path, shown.result, {**series, **shown.series}, {})
    read = [o for o in prediction.outputs if o not in unread]
    return _figure(shown, name, [*read, *unread], figure, dark)


def loop_figure(loop: LoopResult, *, figure: Figure | Axes | None = None, dark: bool = False) -> Figure:
    """Return the output that most was left of, before and after, on data that was not fitted."""
    return scene_figure(loop_view(loop), figure=figure, dark=dark)


def scene_figure(run: RunDirectory, *, figure: Figure | Axes | None = None, dark: bool = False) -> Figure:
    """Return the picture that a run's page opens with."""
    scene = opening_scene(run)
    if scene is None:
        raise InputError(f"{run.path}: the run has no curves to draw")
    words = legend(run, scene.recording)
    return draw_panels(scene_panels(run, scene), TIME, words, title=stretch_words(run, scene), figure=figure, dark=dark)


def run_figure(
    run: RunDirectory, recording: str | None = None, *, figure: Figure | Axes | None = None, dark: bool = False
) -> Figure:
    """Return inputs and outputs of one recording of a run, with what the run says of them; the first by default."""
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
