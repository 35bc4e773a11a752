"""Recordings: read, check, units, align, split."""

from aero_bayes.data.columns import ColumnMap, Layout
from aero_bayes.data.initial_level import initial_level
from aero_bayes.data.mend import mend
from aero_bayes.data.noise_floor import noise_floor, noise_floors, quantisation_step
from aero_bayes.data.read import read_recording, read_recordings, write_csv
from aero_bayes.data.recording import Recording, to_experiment
from aero_bayes.declared import ColumnSpec

__all__ = [
    "ColumnMap",
    "ColumnSpec",
    "Layout",
    "Recording",
    "initial_level",
    "mend",
    "noise_floor",
    "noise_floors",
    "quantisation_step",
    "read_recording",
    "read_recordings",
    "to_experiment",
    "write_csv",
]
