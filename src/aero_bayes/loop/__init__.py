"""What a model predicts of recordings, fitted and unseen, and how far it is off."""

from aero_bayes.data.split import Recordings
from aero_bayes.loop.first_fit import LoopContext, LoopSettings, LoopStatistics, first_fit
from aero_bayes.loop.left_out import Blocks, newton_errors, refitted_errors
from aero_bayes.loop.loop import close_loop
from aero_bayes.loop.models import CandidateModel, FittedModel
from aero_bayes.loop.result import LoopResult
from aero_bayes.loop.search import Search
from aero_bayes.loop.sentences import error_change, left_over
from aero_bayes.loop.table import Row, Table
from aero_bayes.loop.unseen import Prediction, RmsError, Unseen, rms_error

__all__ = [
    "Blocks",
    "CandidateModel",
    "FittedModel",
    "LoopContext",
    "LoopResult",
    "LoopSettings",
    "LoopStatistics",
    "Prediction",
    "Recordings",
    "RmsError",
    "Row",
    "Search",
    "Table",
    "Unseen",
    "close_loop",
    "error_change",
    "first_fit",
    "left_over",
    "newton_errors",
    "refitted_errors",
    "rms_error",
]
