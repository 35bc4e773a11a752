"""The row of the model: a residual that is structured."""

from __future__ import annotations

from aero_bayes.check.residual_tests import check_residuals, structured_residuals
from aero_bayes.data import noise_floors
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.result import Fit


def check_model(fit: Fit) -> DiagnosisRow:
    """Tell which residuals are more than noise."""
    calibration = fit.calibration
    floors = noise_floors(calibration.recordings, calibration.outputs)
    left = structured_residuals(check_residuals(calibration, fit.series, fit.optimum, floors))
    if not left:
        return DiagnosisRow("model", False, "The residual of every output is noise.")
    names = ", ".join(f"`{name}`" for name in sorted({report.output for report in left}))
    where = ", ".join(dict.fromkeys(report.recording for report in left))
    return DiagnosisRow("model", True, f"The residual of {names} is structured.", f"in {where}", explains=True)
