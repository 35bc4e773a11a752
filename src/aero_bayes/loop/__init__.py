"""From a residual to the effect that the model lacks: residual, search, choice, extension, judgement.

>>> from aero_bayes.loop import LoopSettings, close_loop
>>> settings = LoopSettings(parameters=("M",), exclude=("backlash",))
>>> loop = close_loop([recording], model="Rig.mo", settings=settings)  # doctest: +SKIP
>>> loop.sentence, loop.diff  # doctest: +SKIP
"""

from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.loop.base_fit import fit_base_model
from aero_bayes.loop.context import LoopContext, LoopStatistics
from aero_bayes.loop.loop import LoopSettings, close_loop
from aero_bayes.loop.result import LoopResult
from aero_bayes.search.settings import StructureSettings

__all__ = [
    "LocalFitSettings",
    "LoopContext",
    "LoopResult",
    "LoopSettings",
    "LoopStatistics",
    "StructureSettings",
    "close_loop",
    "fit_base_model",
]
