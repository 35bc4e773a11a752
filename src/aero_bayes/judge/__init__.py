"""What to make of a structure: what it leaves, what it predicts, and whether its terms may be named."""

from aero_bayes.judge.checks import Case, Check, EnoughReadings, LeaveBlockOut, LeftOver, PaysItsPrice, Verdict

__all__ = ["Case", "Check", "EnoughReadings", "LeaveBlockOut", "LeftOver", "PaysItsPrice", "Verdict"]
