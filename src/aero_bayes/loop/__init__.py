"""From a residual to the effect that the model lacks: residual, attribution, extension, judgement.

>>> from pathlib import Path
>>> from aero_bayes.loop import LoopSettings, close_loop
>>> settings = LoopSettings(sources=(Path("Rig.mo"),), free=("M",), exclude=("backlash",))
>>> loop = close_loop([recording], model="Rig", settings=settings)  # doctest: +SKIP
>>> loop.sentence, loop.diff  # doctest: +SKIP
"""

from aero_bayes.estimate.climb import ClimbSettings
from aero_bayes.loop.loop import LoopSettings, close_loop
from aero_bayes.loop.result import FoundEffect, LoopResult, NewParameter
from aero_bayes.loop.settings import AttributeSettings

__all__ = [
    "AttributeSettings",
    "ClimbSettings",
    "FoundEffect",
    "LoopResult",
    "LoopSettings",
    "NewParameter",
    "close_loop",
]
