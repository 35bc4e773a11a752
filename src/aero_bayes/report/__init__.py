"""Figures of the library's objects, drawn with matplotlib in the look of the page."""

from aero_bayes.report.compare import write_comparison
from aero_bayes.report.drawing import Line, Panel, Source, data_table, draw, nice_ticks
from aero_bayes.report.fleet_page import write_fleet_page
from aero_bayes.report.loop_figures import curve_plate, rounds_table
from aero_bayes.report.loop_story import changed_equations
from aero_bayes.report.page import BITS, pack_series, write_run_page
from aero_bayes.report.pairs import pairs_figure
from aero_bayes.report.plot_page import loop_page
from aero_bayes.report.plots import (
    bands_figure,
    fit_figure,
    loop_figure,
    palette,
    prediction_figure,
    recording_figure,
    rounds_figure,
    run_figure,
    scene_figure,
)
from aero_bayes.report.posterior_figures import most_correlated
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_estimate import (
    ComponentJson,
    ConnectionJson,
    DiagramJson,
    McmcJson,
    ModeDrawsJson,
    ParameterJson,
    ProfileJson,
    QuantilesJson,
    SensorJson,
    ShapeJson,
    VerdictJson,
)
from aero_bayes.report.schema_loop import (
    CandidateJson,
    EffectJson,
    LoopJson,
    StepJson,
)
from aero_bayes.report.schema_run import (
    SCHEMA,
    DesignJson,
    FleetEffectJson,
    FleetJson,
    FleetParameterJson,
    RangeJson,
    RigReasonJson,
    RunJson,
    undeclared,
)
from aero_bayes.report.svg import Canvas
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import duration, pretty_unit, rounded_value, sentence, signed, significant, symbol, tidy
from aero_bayes.report.thinning import band_envelope, column_means, envelope

__all__ = [
    "BITS",
    "SCHEMA",
    "CandidateJson",
    "Canvas",
    "Column",
    "ComponentJson",
    "ConnectionJson",
    "DesignJson",
    "DiagramJson",
    "EffectJson",
    "FleetEffectJson",
    "FleetJson",
    "FleetParameterJson",
    "Line",
    "LoopJson",
    "McmcJson",
    "ModeDrawsJson",
    "Panel",
    "ParameterJson",
    "ProfileJson",
    "QuantilesJson",
    "RangeJson",
    "RigReasonJson",
    "RunDirectory",
    "RunJson",
    "SensorJson",
    "ShapeJson",
    "Source",
    "StepJson",
    "VerdictJson",
    "band_envelope",
    "bands_figure",
    "changed_equations",
    "column_means",
    "curve_plate",
    "data_table",
    "draw",
    "duration",
    "envelope",
    "fit_figure",
    "html_table",
    "loop_figure",
    "loop_page",
    "most_correlated",
    "nice_ticks",
    "pack_series",
    "pairs_figure",
    "palette",
    "prediction_figure",
    "pretty_unit",
    "recording_figure",
    "rounded_value",
    "rounds_figure",
    "rounds_table",
    "run_figure",
    "scene_figure",
    "sentence",
    "signed",
    "significant",
    "symbol",
    "tidy",
    "undeclared",
    "write_comparison",
    "write_fleet_page",
    "write_run_page",
]
