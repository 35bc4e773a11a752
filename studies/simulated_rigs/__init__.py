"""Simulated rigs of many kinds with a law that their model lacks."""

from simulated_rigs.fleet import FleetTruth, draw_fleet, draw_rig, write_fleet
from simulated_rigs.trial import DEVELOPMENT, MODELS, REPORT, RigTrial, RigTruth, draw_rig_trial, rig_kinds, write_trial
from simulated_rigs.truth import LawPlace, LawTruth, law_places, simulate_rig

__all__ = [
    "DEVELOPMENT",
    "MODELS",
    "REPORT",
    "FleetTruth",
    "LawPlace",
    "LawTruth",
    "RigTrial",
    "RigTruth",
    "draw_fleet",
    "draw_rig",
    "draw_rig_trial",
    "law_places",
    "rig_kinds",
    "simulate_rig",
    "write_fleet",
    "write_trial",
]
