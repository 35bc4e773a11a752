"""Simulated rigs of many kinds with a law that their model lacks; never imported by what fits them."""

from simulated_rigs.fleet import FleetTruth, draw_fleet, draw_rig, write_fleet
from simulated_rigs.trial import (
    DEVELOPMENT,
    MODELS,
    REPORT,
    RigTrial,
    RigTruth,
    draw_trial,
    rig_kinds,
    write_trial,
)
from simulated_rigs.truth import LawTruth, Place, places, simulate

__all__ = [
    "DEVELOPMENT",
    "MODELS",
    "REPORT",
    "FleetTruth",
    "LawTruth",
    "Place",
    "RigTrial",
    "RigTruth",
    "draw_fleet",
    "draw_rig",
    "draw_trial",
    "places",
    "rig_kinds",
    "simulate",
    "write_fleet",
    "write_trial",
]
