"""What ``result.json`` holds, as typed classes: every command fills one :class:`RunResult`, every page reads one.

A key that a command did not write keeps its default, so that a reader never asks whether it is there. Numbers are in SI
units; ``None`` stands for what is not known or not finite. Keys that no class names are kept and can be listed with
:func:`undeclared`; the tests allow none in what the program writes.
"""

from aero_bayes.schema.base import ParameterResult, Quantiles, Verdict
from aero_bayes.schema.design import DesignCheck, DesignedParameter, DesignLimits, DesignResult, RivalResult
from aero_bayes.schema.estimate import (
    Combination,
    Convergence,
    DataFile,
    EncoderResult,
    FitResult,
    Identifiability,
    LeftOutResult,
    LocalResult,
    McmcResult,
    NoiseResult,
    PredictionResult,
    Profile,
    RecordingResult,
    ResidualResult,
    RippleOrder,
    RippleResult,
    SensorResult,
    StageResult,
    StretchesResult,
    SwarmResult,
)
from aero_bayes.schema.fleet import FleetCost, FleetEffect, FleetParameter, FleetResult, Range, RigReason
from aero_bayes.schema.loop import (
    CandidateResult,
    EffectResult,
    Evidence,
    LoopPart,
    ShiftResult,
    StepResult,
)
from aero_bayes.schema.model import Component, Connection, Diagram, ModelResult, Shape, Signal
from aero_bayes.schema.run import SCHEMA, RunResult, undeclared
from aero_bayes.schema.study import StudyColumn, StudyResult, StudyRow

__all__ = [
    "SCHEMA",
    "CandidateResult",
    "Combination",
    "Component",
    "Connection",
    "Convergence",
    "DataFile",
    "DesignCheck",
    "DesignLimits",
    "DesignResult",
    "DesignedParameter",
    "Diagram",
    "EffectResult",
    "EncoderResult",
    "Evidence",
    "FitResult",
    "FleetCost",
    "FleetEffect",
    "FleetParameter",
    "FleetResult",
    "Identifiability",
    "LeftOutResult",
    "LocalResult",
    "LoopPart",
    "McmcResult",
    "ModelResult",
    "NoiseResult",
    "ParameterResult",
    "PredictionResult",
    "Profile",
    "Quantiles",
    "Range",
    "RecordingResult",
    "ResidualResult",
    "RigReason",
    "RippleOrder",
    "RippleResult",
    "RivalResult",
    "RunResult",
    "SensorResult",
    "Shape",
    "ShiftResult",
    "Signal",
    "StageResult",
    "StepResult",
    "StretchesResult",
    "StudyColumn",
    "StudyResult",
    "StudyRow",
    "SwarmResult",
    "Verdict",
    "undeclared",
]
