"""A simulated AERO that makes labelled recordings; no code that fits them imports it."""

from aero_bayes.data import write_csv
from simulated_aero.defaults import SimulatedSet, default_recordings, default_truth
from simulated_aero.effects import KINDS, EffectKind
from simulated_aero.inputs import (
    Chirp,
    InputDesign,
    Levels,
    MultiSine,
    equal_steps,
    paper_step,
    prbs,
    pulse,
    random_levels,
    random_multi_sine,
)
from simulated_aero.rig import TrueRun, effect, even_times, measure, simulate_recording, simulate_truth
from simulated_aero.sensors import SensorNoise, Sensors, clean, real, white
from simulated_aero.truth import HALF_QUAD, EffectTruth, Parameters, Truth

__all__ = [
    "HALF_QUAD",
    "KINDS",
    "Chirp",
    "EffectKind",
    "EffectTruth",
    "InputDesign",
    "Levels",
    "MultiSine",
    "Parameters",
    "SensorNoise",
    "Sensors",
    "SimulatedSet",
    "TrueRun",
    "Truth",
    "clean",
    "default_recordings",
    "default_truth",
    "effect",
    "equal_steps",
    "even_times",
    "measure",
    "paper_step",
    "prbs",
    "pulse",
    "random_levels",
    "random_multi_sine",
    "real",
    "simulate_recording",
    "simulate_truth",
    "white",
    "write_csv",
]
