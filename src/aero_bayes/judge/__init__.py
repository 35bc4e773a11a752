"""What to make of structures: what they leave, what they predict, and which of them is the cause."""

from aero_bayes.judge.choice import Choice, ChoiceSettings, Judge
from aero_bayes.judge.choose import Chooser, finalists, rank
from aero_bayes.judge.prediction import Prediction, RmsError, describe_error_change, rms_error, surely_worse
from aero_bayes.judge.recordings import Recordings
from aero_bayes.judge.validation import MAX_ERROR_RATIO, rejection_reason
from aero_bayes.search.comparison import Comparison, Share
from aero_bayes.search.left_out import CommonBlocks, newton_errors, refitted_errors

__all__ = [
    "MAX_ERROR_RATIO",
    "Choice",
    "ChoiceSettings",
    "Chooser",
    "CommonBlocks",
    "Comparison",
    "Judge",
    "Prediction",
    "Recordings",
    "RmsError",
    "Share",
    "describe_error_change",
    "finalists",
    "newton_errors",
    "rank",
    "refitted_errors",
    "rejection_reason",
    "rms_error",
    "surely_worse",
]
