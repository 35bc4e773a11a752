"""From a residual to the effect that the model lacks: residual, locate, attribute, extend, judge."""

from aero_bayes.discrepancy.attribute import AttributeSettings
from aero_bayes.discrepancy.loop import LoopSettings, close_loop
from aero_bayes.discrepancy.refit import RefitSettings
from aero_bayes.discrepancy.result import FoundEffect, LoopResult, NewParameter

__all__ = [
    "AttributeSettings",
    "FoundEffect",
    "LoopResult",
    "LoopSettings",
    "NewParameter",
    "RefitSettings",
    "close_loop",
]
