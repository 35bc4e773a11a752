"""The closed loop: search over structures, decision, extended model, and what is said of it."""

from aero_bayes.loop.first_fit import LoopSettings
from aero_bayes.loop.loop import close_loop
from aero_bayes.loop.result import LoopResult

__all__ = ["LoopResult", "LoopSettings", "close_loop"]
