"""Simulated rigs of many kinds with a law that their model lacks; never imported by what fits them."""

from aero_bayes.bench.rigs.fleet import FleetTruth, draw_fleet, draw_rig, write_fleet
from aero_bayes.bench.rigs.trial import (
    DEVELOPMENT,
    REPORT,
    RigTrial,
    RigTruth,
    draw_trial,
    models_folder,
    rig_kinds,
    write_trial,
)
from aero_bayes.bench.rigs.truth import LawTruth, Place, places, simulate

__all__ = [
    "DEVELOPMENT",
    "REPORT",
    "FleetTruth",
    "LawTruth",
    "Place",
    "RigTrial",
    "RigTruth",
    "draw_fleet",
    "draw_rig",
    "draw_trial",
    "models_folder",
    "places",
    "rig_kinds",
    "simulate",
    "write_fleet",
    "write_trial",
]
