"""What to make of structures: what they leave, what they predict, and which of them is the cause."""

from aero_bayes.judge.choice import Choice
from aero_bayes.judge.choose import Chooser
from aero_bayes.judge.judge import ChoiceSettings, Judge
from aero_bayes.judge.prediction import Prediction, RmsError, describe_error_change, rms_error, surely_worse
from aero_bayes.judge.recordings import Recordings
from aero_bayes.judge.validation import MAX_ERROR_RATIO, rejection_reason

__all__ = [
    "MAX_ERROR_RATIO",
    "Choice",
    "ChoiceSettings",
    "Chooser",
    "Judge",
    "Prediction",
    "Recordings",
    "RmsError",
    "describe_error_change",
    "rejection_reason",
    "rms_error",
    "surely_worse",
]
