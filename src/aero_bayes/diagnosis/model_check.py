"""The row of the model: a residual that is structured."""

from __future__ import annotations

from aero_bayes.diagnosis.left_over import LeftOver
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.result import Fit


def check_model(fit: Fit, left: LeftOver) -> DiagnosisRow:
    """Tell which residuals are more than noise."""
    structured = left.structured
    if not structured:
        return DiagnosisRow("model", False, "The residual of every output is noise.")
    names = ", ".join(f"`{name}`" for name in sorted({report.output for report in structured}))
    where = ", ".join(dict.fromkeys(report.recording for report in structured))
    return DiagnosisRow("model", True, f"The residual of {names} is structured.", f"in {where}", explains=True)
