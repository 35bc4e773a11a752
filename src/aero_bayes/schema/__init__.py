"""Typed classes of ``result.json``: every command fills one :class:`RunJson`, every page reads one.

A key that a command did not write keeps its default, so that a reader never asks whether it is there. Numbers are in SI
units; ``None`` stands for what is not known or not finite. Keys that no class names are kept and can be listed with
:func:`undeclared`; the tests allow none in what the program writes.
"""

from aero_bayes.schema.base import ParameterJson, QuantilesJson, VerdictJson
from aero_bayes.schema.design import DesignCheckJson, DesignedParameterJson, DesignJson, DesignLimitsJson, RivalJson
from aero_bayes.schema.estimate import (
    CombinationJson,
    ConvergenceJson,
    DataFileJson,
    EncoderJson,
    FitJson,
    IdentifiabilityJson,
    LeftOutJson,
    LocalJson,
    McmcJson,
    ModeDrawsJson,
    NoiseJson,
    PredictionJson,
    ProfileJson,
    RecordingJson,
    ResidualJson,
    RippleJson,
    RippleOrderJson,
    SensorJson,
    StageJson,
    StretchesJson,
    SwarmJson,
)
from aero_bayes.schema.fleet import (
    FleetCostJson,
    FleetEffectJson,
    FleetJson,
    FleetParameterJson,
    RangeJson,
    RigReasonJson,
)
from aero_bayes.schema.loop import (
    CandidateJson,
    EffectJson,
    LoopJson,
    ShiftJson,
    StepJson,
)
from aero_bayes.schema.model import ComponentJson, ConnectionJson, DiagramJson, ModelJson, ShapeJson, SignalJson
from aero_bayes.schema.run import SCHEMA, RunJson, undeclared
from aero_bayes.schema.study import StudyColumnJson, StudyJson, StudyRowJson

__all__ = [
    "SCHEMA",
    "CandidateJson",
    "CombinationJson",
    "ComponentJson",
    "ConnectionJson",
    "ConvergenceJson",
    "DataFileJson",
    "DesignCheckJson",
    "DesignJson",
    "DesignLimitsJson",
    "DesignedParameterJson",
    "DiagramJson",
    "EffectJson",
    "EncoderJson",
    "FitJson",
    "FleetCostJson",
    "FleetEffectJson",
    "FleetJson",
    "FleetParameterJson",
    "IdentifiabilityJson",
    "LeftOutJson",
    "LocalJson",
    "LoopJson",
    "McmcJson",
    "ModeDrawsJson",
    "ModelJson",
    "NoiseJson",
    "ParameterJson",
    "PredictionJson",
    "ProfileJson",
    "QuantilesJson",
    "RangeJson",
    "RecordingJson",
    "ResidualJson",
    "RigReasonJson",
    "RippleJson",
    "RippleOrderJson",
    "RivalJson",
    "RunJson",
    "SensorJson",
    "ShapeJson",
    "ShiftJson",
    "SignalJson",
    "StageJson",
    "StepJson",
    "StretchesJson",
    "StudyColumnJson",
    "StudyJson",
    "StudyRowJson",
    "SwarmJson",
    "VerdictJson",
    "undeclared",
]
