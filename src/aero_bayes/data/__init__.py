"""Recordings: read, check, units, align, split."""

from aero_bayes.data.align import hold_signal, input_before, to_experiment
from aero_bayes.data.checks import check_recording
from aero_bayes.data.layout import AERO, ColumnMap, Layout, Quantity
from aero_bayes.data.read import read_recording, write_csv
from aero_bayes.data.recording import Recording

__all__ = [
    "AERO",
    "ColumnMap",
    "Layout",
    "Quantity",
    "Recording",
    "check_recording",
    "hold_signal",
    "input_before",
    "read_recording",
    "to_experiment",
    "write_csv",
]
