"""The row of the data: faults of the readings, as they were found before the fit."""

from __future__ import annotations

from aero_bayes.diagnosis.left_over import LeftOver
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.result import Fit


def check_data(fit: Fit, left: LeftOver) -> DiagnosisRow:
    """Tell what is wrong with the readings of the fitted recordings."""
    findings = list(dict.fromkeys(f for recording in fit.calibration.data.recordings for f in recording.findings))
    if not findings:
        return DiagnosisRow(
            "data", False, "No impossible or stuck readings, outliers, clipping, gaps in time or jumps of a turn."
        )
    findings.sort(key=lambda f: f.mended)
    first, more = findings[0], tuple(f.sentence for f in findings[1:])
    return DiagnosisRow("data", True, first.what, first.where, first.done, not first.mended, more)
