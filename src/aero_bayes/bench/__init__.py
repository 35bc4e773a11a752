"""The simulated AERO that makes labelled recordings; never imported by what fits them."""

from aero_bayes.bench.defaults import SimulatedSet, default_recordings, default_truth
from aero_bayes.bench.inputs import (
    Chirp,
    InputDesign,
    Levels,
    MultiSine,
    multi_sine,
    paper_step,
    prbs,
    pulse,
    random_levels,
    staircase,
)
from aero_bayes.bench.rig import TrueRun, effect, measure, sample_times, simulate, simulate_recording
from aero_bayes.bench.sensors import Noise, Sensors, clean, real, white
from aero_bayes.bench.truth import HALF_QUAD, EffectTruth, Parameters, Truth
from aero_bayes.data import write_csv

__all__ = [
    "HALF_QUAD",
    "Chirp",
    "EffectTruth",
    "InputDesign",
    "Levels",
    "MultiSine",
    "Noise",
    "Parameters",
    "Sensors",
    "SimulatedSet",
    "TrueRun",
    "Truth",
    "clean",
    "default_recordings",
    "default_truth",
    "effect",
    "measure",
    "multi_sine",
    "paper_step",
    "prbs",
    "pulse",
    "random_levels",
    "real",
    "sample_times",
    "simulate",
    "simulate_recording",
    "staircase",
    "white",
    "write_csv",
]
