"""Simulated rigs of many kinds with a law that their model lacks."""

from simulated_rigs.trial import DEVELOPMENT, MODELS, REPORT, RigTrial, draw_rig_trial, write_trial
from simulated_rigs.truth import LawPlace, LawTruth, law_places, simulate_rig

__all__ = [
    "DEVELOPMENT",
    "MODELS",
    "REPORT",
    "LawPlace",
    "LawTruth",
    "RigTrial",
    "draw_rig_trial",
    "law_places",
    "simulate_rig",
    "write_trial",
]
