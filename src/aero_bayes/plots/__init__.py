"""Figures of the library's objects, drawn with matplotlib in the look of the page."""

from aero_bayes.plots.curves import (
    bands_figure,
    fit_figure,
    loop_figure,
    prediction_figure,
    recording_figure,
    run_figure,
    scene_figure,
)
from aero_bayes.plots.page import loop_page
from aero_bayes.plots.pairs import pairs_figure
from aero_bayes.plots.rounds import rounds_figure
from aero_bayes.plots.style import palette

__all__ = [
    "bands_figure",
    "fit_figure",
    "loop_figure",
    "loop_page",
    "pairs_figure",
    "palette",
    "prediction_figure",
    "recording_figure",
    "rounds_figure",
    "run_figure",
    "scene_figure",
]
