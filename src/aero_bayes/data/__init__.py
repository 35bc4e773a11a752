"""Recordings: read, check, units, align, split."""

from aero_bayes.data.checks import check_recording
from aero_bayes.data.experiment import hold_signal, input_before, to_experiment
from aero_bayes.data.layout import ColumnMap, Layout
from aero_bayes.data.noise import NoiseFloor, floors_of, noise_floor, noise_of, quantisation_step
from aero_bayes.data.read import read_recording, write_csv
from aero_bayes.data.recording import Recording
from aero_bayes.data.ripple import ripple
from aero_bayes.data.summary import InputSummary, OutputSummary, Summary, summarise
from aero_bayes.declared import ColumnSpec

__all__ = [
    "ColumnMap",
    "ColumnSpec",
    "InputSummary",
    "Layout",
    "NoiseFloor",
    "OutputSummary",
    "Recording",
    "Summary",
    "check_recording",
    "floors_of",
    "hold_signal",
    "input_before",
    "noise_floor",
    "noise_of",
    "quantisation_step",
    "read_recording",
    "ripple",
    "summarise",
    "to_experiment",
    "write_csv",
]
