"""How wide a 90 % band of new readings must be, from the errors of predicting readings that were left out.

A band of ``1.645`` standard deviations of the noise and of the parameters together holds 90 % of new readings if the
model is right. If it is not, its errors have another distribution, and they are larger where it was not fitted. So the
factor is taken from the data by cross-conformal prediction (Vovk, 2015, Annals of Mathematics and Artificial
Intelligence 74, 9; Barber, Candes, Ramdas and Tibshirani, 2021, Annals of Statistics 49, 486): errors of leave-out
predictions in units of the standard deviation, and of these the quantile that new errors exceed in 10 % of cases.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.leave_out import BLOCK_COUNT, MIN_BLOCK_READINGS, LinearisedFit, Readings, blocks_of_time
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Series
from aero_bayes.sensors.whiteness import residual_correlation_time
from aero_bayes.simulation.gaussian import NORMAL_HALF_WIDTH

#: Share of new readings that a band holds.
BAND_SHARE = 0.9
#: Average length of a block that is left out, in correlation times of the residual.
BLOCK_LENGTH = 2.0


def band_factors(
    calibration: Calibration,
    series: Sequence[Series],
    optimum: Optimum,
    covariance: FloatArray,
    residuals: Sequence[FloatArray],
) -> FloatArray:
    """Compute the half-width of the 90 % band of each output, in standard deviations of a predicted reading."""
    if calibration.simulated.process is not None:  # the filter says how much each reading differs from its prediction
        return np.full(len(calibration.data.outputs), NORMAL_HALF_WIDTH)
    assert optimum.evaluation.slopes is not None
    slopes = optimum.evaluation.slopes
    fitted = [residuals[s.experiment][s.sampling.index, s.column] for s in series]
    changes = _leave_out_changes(calibration, series, optimum)
    factors = np.full(len(calibration.data.outputs), NORMAL_HALF_WIDTH)
    for column, output in enumerate(calibration.data.outputs):
        own = [k for k, s in enumerate(series) if s.column == column]
        if not own:
            continue
        noise = optimum.noise[output].sd
        sds = [np.sqrt(noise**2 + np.einsum("kn,kl,ln->n", slopes[k], covariance, slopes[k])) for k in own]
        inside = np.concatenate([np.abs(fitted[k]) / sd for k, sd in zip(own, sds, strict=True)])
        outside = [np.abs(fitted[k] - changes[k]) / sd for k, sd in zip(own, sds, strict=True)]
        factors[column] = max(
            NORMAL_HALF_WIDTH, float(np.quantile(inside, BAND_SHARE)), conformal_quantile(outside, BAND_SHARE)
        )
    return factors


def conformal_quantile(scores: Sequence[FloatArray], share: float) -> float:
    """Compute the value that a new score exceeds with probability ``1 - share`` at most, from correlated scores."""
    every = np.concatenate(scores)
    independent = every.size / residual_correlation_time(scores)
    return float(np.quantile(every, min(share * (1.0 + 1.0 / independent), 1.0)))


def _leave_out_changes(calibration: Calibration, series: Sequence[Series], optimum: Optimum) -> list[FloatArray]:
    """Compute the change of each fitted output (n,) when the recording, or the only one's block, is left out.

    Initial values and delays that belong to one recording stay as fitted to all its readings."""
    assert optimum.evaluation.slopes is not None
    parameters = calibration.parameters
    shared = [k for k, j in enumerate(optimum.free) if parameters.items[j].recording is None]
    linear = LinearisedFit.of(optimum, parameters, shared)
    plain = np.concatenate([by[shared] for by in optimum.evaluation.slopes], axis=1)
    changes = np.zeros(plain.shape[1])
    for left in linear.without(_parts(series, linear.leverage, optimum)):
        changes[left.readings] = left.step @ plain[:, left.readings]
    return np.split(changes, np.cumsum([s.sampling.size for s in series])[:-1])


def _parts(series: Sequence[Series], leverage: FloatArray, optimum: Optimum) -> list[Readings]:
    """Return what is left out in turn: each recording.

    Of a single one, blocks that are long beside the residual's memory."""
    lengths = [residual_correlation_time([r]) for r in optimum.evaluation.residual]
    least = math.ceil(BLOCK_LENGTH * sum(lengths))
    by_recording = blocks_of_time(series, leverage, BLOCK_COUNT, max(least, MIN_BLOCK_READINGS))
    if len(by_recording) > 1:
        return [np.concatenate(blocks) for blocks in by_recording]
    return by_recording[0]
