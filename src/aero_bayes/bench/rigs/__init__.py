"""Simulated rigs of many kinds with a law that their model lacks; never imported by what fits them."""

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
    "LawTruth",
    "Place",
    "RigTrial",
    "RigTruth",
    "draw_trial",
    "models_folder",
    "places",
    "rig_kinds",
    "simulate",
    "write_trial",
]
