"""A finished run, or several side by side, as one self-contained HTML page."""

from aero_bayes.report.compare import write_comparison
from aero_bayes.report.drawing import Line, Panel, Source, draw, nice_ticks
from aero_bayes.report.embed import BITS, pack_series
from aero_bayes.report.figure import data_table
from aero_bayes.report.fleet_page import write_fleet_page
from aero_bayes.report.loop_figures import curve_plate, rounds_plate
from aero_bayes.report.loop_story import changed_equations
from aero_bayes.report.page import write_run_page
from aero_bayes.report.posterior_figures import most_correlated
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.svg import Canvas
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import duration, pretty_unit, rounded_value, sentence, signed, significant, symbol, tidy
from aero_bayes.report.thinning import band_envelope, column_means, envelope

__all__ = [
    "BITS",
    "Canvas",
    "Column",
    "Line",
    "Panel",
    "RunDirectory",
    "Source",
    "band_envelope",
    "changed_equations",
    "column_means",
    "curve_plate",
    "data_table",
    "draw",
    "duration",
    "envelope",
    "html_table",
    "most_correlated",
    "nice_ticks",
    "pack_series",
    "pretty_unit",
    "rounded_value",
    "rounds_plate",
    "sentence",
    "signed",
    "significant",
    "symbol",
    "tidy",
    "write_comparison",
    "write_fleet_page",
    "write_run_page",
]
