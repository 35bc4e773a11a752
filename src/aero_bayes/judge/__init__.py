"""What to make of a structure: what it leaves, what it predicts, and whether its terms may be named."""

from aero_bayes.judge.checks import (
    Check,
    CheckInput,
    CheckResult,
    Choice,
    EnoughEvidence,
    EnoughReadings,
    LeaveBlockOut,
    LeftOver,
    choose,
)
from aero_bayes.judge.holdout import HeldOutGain, blocks_of, held_out_gain
from aero_bayes.judge.prediction import Error, Prediction, describe_error_change, rms_error, surely_worse
from aero_bayes.judge.recordings import Recordings
from aero_bayes.judge.validation import MAX_ERROR_RATIO, refusal

__all__ = [
    "MAX_ERROR_RATIO",
    "Check",
    "CheckInput",
    "CheckResult",
    "Choice",
    "EnoughEvidence",
    "EnoughReadings",
    "Error",
    "HeldOutGain",
    "LeaveBlockOut",
    "LeftOver",
    "Prediction",
    "Recordings",
    "blocks_of",
    "choose",
    "describe_error_change",
    "held_out_gain",
    "refusal",
    "rms_error",
    "surely_worse",
]
