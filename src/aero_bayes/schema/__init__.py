"""Typed classes of ``result.json``: every command fills one :class:`RunJson`, every page reads one.

A key that a command did not write keeps its default, so that a reader never asks whether it is there. Numbers are in SI
units; ``None`` stands for what is not known or not finite. Keys that no class names are kept and can be listed with
:func:`undeclared`; the tests allow none in what the program writes.
"""

from aero_bayes.schema.base import ParameterJson, QuantilesJson, VerdictJson
from aero_bayes.schema.design import DesignJson
from aero_bayes.schema.estimate import McmcJson, ModeDrawsJson, ProfileJson, SensorJson
from aero_bayes.schema.fleet import (
    FleetEffectJson,
    FleetJson,
    FleetParameterJson,
    RangeJson,
    RigReasonJson,
)
from aero_bayes.schema.loop import CandidateJson, EffectJson, LoopJson, StepJson
from aero_bayes.schema.model import ComponentJson, ConnectionJson, DiagramJson, ShapeJson
from aero_bayes.schema.run import SCHEMA, RunJson, undeclared
from aero_bayes.schema.study import StudyColumnJson, StudyJson, StudyRowJson

__all__ = [
    "SCHEMA",
    "CandidateJson",
    "ComponentJson",
    "ConnectionJson",
    "DesignJson",
    "DiagramJson",
    "EffectJson",
    "FleetEffectJson",
    "FleetJson",
    "FleetParameterJson",
    "LoopJson",
    "McmcJson",
    "ModeDrawsJson",
    "ParameterJson",
    "ProfileJson",
    "QuantilesJson",
    "RangeJson",
    "RigReasonJson",
    "RunJson",
    "SensorJson",
    "ShapeJson",
    "StepJson",
    "StudyColumnJson",
    "StudyJson",
    "StudyRowJson",
    "VerdictJson",
    "undeclared",
]
