"""Errors on unseen data that are much larger than what an adequate fit leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.check.residual_tests import ResidualReport
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.judge.prediction import Prediction
from aero_bayes.judge.unseen import Unseen

#: Largest error of a prediction of unseen data, in standard deviations of the prediction.
MAX_PREDICTION_DEVIATIONS = 4.0


@dataclass(frozen=True)
class LargeUnseenErrors:
    """Outputs whose error on unseen data is much larger than that of the fit: the ratio, by recording and output.

    ``sensitive`` are those where the uncertainty of the parameters explains it, ``unexplained`` the others."""

    sensitive: Mapping[tuple[str, str], float]
    unexplained: Mapping[tuple[str, str], float]


def large_unseen_errors(
    unseen: Unseen,
    calibration: Calibration,
    fit: Optimum,
    reports: Sequence[ResidualReport],
    floors: Mapping[tuple[str, str], float],
    before: Prediction,
    max_error_ratio: float,
) -> LargeUnseenErrors:
    """Find outputs that an adequate fit predicts with a much larger error on unseen data."""
    adequate = {(r.recording, r.output): r.rms for r in reports if r.verdict == "adequate"}
    far: dict[tuple[str, str], float] = {}
    for (name, output), error in before.test.items():
        own = [rms for (_, other), rms in adequate.items() if other == output]
        expected = max([fit.noise[output].sd, floors.get((name, output), 0.0), *own])
        if error.rms > max_error_ratio * expected:
            far[name, output] = error.rms / expected
    if not far:
        return LargeUnseenErrors({}, {})
    unsure = unseen.uncertainty_of(calibration, fit)
    sensitive = {k for k in far if before.test[k].rms <= MAX_PREDICTION_DEVIATIONS * unsure[k]}
    return LargeUnseenErrors(
        {k: v for k, v in far.items() if k in sensitive}, {k: v for k, v in far.items() if k not in sensitive}
    )
