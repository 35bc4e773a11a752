"""From a residual to the effect that the model lacks: first fit, search, decision, extension, judgement.

>>> from aero_bayes.loop import LoopSettings, close_loop
>>> settings = LoopSettings(parameters=("M",), exclude=("backlash",))
>>> loop = close_loop([recording], model="Rig.mo", settings=settings)  # doctest: +SKIP
>>> loop.sentence, loop.diff  # doctest: +SKIP
"""

from aero_bayes.loop.context import LoopContext, LoopStatistics
from aero_bayes.loop.first_fit import first_fit
from aero_bayes.loop.loop import LoopSettings, close_loop
from aero_bayes.loop.result import LoopResult

__all__ = ["LoopContext", "LoopResult", "LoopSettings", "LoopStatistics", "close_loop", "first_fit"]
