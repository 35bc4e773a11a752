"""Test chosen effects by the last fit and once on unseen data: the test may reject them, and never chooses others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.check.residual_tests import ResidualReport, structured_residuals
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.judge.prediction import MIN_GROWTH_RATIO, Prediction, surely_worse
from aero_bayes.judge.recordings import Recordings
from aero_bayes.judge.unseen import Unseen

#: Largest ratio of the error with the named terms to that without them where they leave structure: in the last fit that
#: of one output, on validation data the product over outputs, so that a gain of one does not hide the loss of another.
MAX_ERROR_RATIO = 0.9
#: Growth of an output's error on validation data that refuses even where few independent readings leave it unsure, if
#: only noise is left; where structure is left, a term may not worsen an output by what it has to improve: a tenth.
MAX_GROWTH_RATIO = 2.0
#: Largest error of a prediction of validation data, in standard deviations of the prediction.
MAX_PREDICTION_DEVIATIONS = 4.0


def rejection_reason(
    before: Prediction, after: Prediction, recordings: Recordings, left: Sequence[ResidualReport]
) -> str | None:
    """Say why the last fit or unseen data reject terms; None where they do not."""
    structured = bool(structured_residuals(left))
    least, fitted = before.pooled("train"), after.pooled("train")
    if structured and fitted and all(fitted[o] > MAX_ERROR_RATIO * least[o] for o in fitted):
        return "in the last fit the error hardly falls."
    if not after.test:
        return None
    first, last = before.pooled("test"), after.pooled("test")
    surely = surely_worse(after, before, recordings)
    unsure = 1.0 / MAX_ERROR_RATIO if structured else MAX_GROWTH_RATIO
    worse = [o for o in last if last[o] > (MIN_GROWTH_RATIO if o in surely else unsure) * first[o]]
    if worse:
        return f"the prediction of unseen data gets worse ({', '.join(worse)})."
    if structured and not math.prod(last.values()) < MAX_ERROR_RATIO * math.prod(first[o] for o in last):
        return "the prediction of unseen data does not improve."
    return None


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
