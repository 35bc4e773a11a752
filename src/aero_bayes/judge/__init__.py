"""What to make of a structure: what it leaves, what it predicts, and whether its terms may be named."""

from aero_bayes.judge.checks import (
    Check,
    CheckInput,
    CheckResult,
    EnoughEvidence,
    EnoughReadings,
    LeaveBlockOut,
    LeftOver,
)

__all__ = ["Check", "CheckInput", "CheckResult", "EnoughEvidence", "EnoughReadings", "LeaveBlockOut", "LeftOver"]
