"""Quantisation of outputs, as a fit shows it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy  # imports its parts when they are first used
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp

from aero_bayes.arrays import FloatArray
from aero_bayes.data.noise import quantisation_step
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.noise_estimation import estimate_noise
from aero_bayes.plain import picked

#: Gain in log-likelihood above which the exact likelihood is preferred to the Gaussian one.
MIN_ROUNDING_GAIN = 3.0


def quantum(values: FloatArray) -> float:
    """Step of quantised readings, such as an encoder's count; 0 for continuous ones."""
    return quantisation_step(values) or 0.0


def thin_constant_readings(
    time: FloatArray, values: FloatArray, longest: float = 0.5, keep: int = 3, spacing: float = 2.5
) -> NDArray[np.bool_]:
    """Return which readings to keep where a reading is constant for long, because equal readings
    are not independent."""
    use = np.isfinite(values)
    index = np.flatnonzero(use)
    if index.size == 0:
        return use
    seen = values[index]
    edges = np.concatenate(([0], np.flatnonzero(np.diff(seen) != 0.0) + 1, [seen.size]))
    for start, stop in pairwise(edges):
        lasted = float(time[index[stop - 1]] - time[index[start]])
        if lasted > longest:
            number = max(keep, round(lasted / spacing))
            kept = np.round(np.linspace(start, stop - 1, number)).astype(int)
            use[index[start:stop]] = False
            use[index[kept]] = True
    return use


@dataclass(frozen=True)
class Quantisation:
    """Quantisation of an output, as its residual shows it."""

    step: float
    error: OutputNoise
    share: float
    sd: float
    gain: float

    @property
    def exact(self) -> bool:
        """Whether the exact likelihood describes the readings clearly better than the Gaussian one."""
        return self.gain > MIN_ROUNDING_GAIN

    def to_dict(self) -> dict[str, object]:
        error = {"error_sd": self.error.sd, "error_lasts_s": self.error.tau}
        return picked(self, "step share gain exact", sd_before_rounding=self.sd, **error)


def rounding_error(time: FloatArray, fitted: FloatArray, step: float, zero: float = 0.0) -> OutputNoise:
    """Estimate the rounding error of a signal (n,), as noise: the least noise that an encoder has.

    The error of a signal that crosses many steps between samples is white, with standard deviation ``step / sqrt(12)``.
    That of a slow signal is correlated for as long as the signal takes for a step."""
    error = zero + step * np.round((fitted - zero) / step) - fitted
    return estimate_noise([time], [error], "auto")


def interval_log_density(reading: FloatArray, predicted: FloatArray, sd: FloatArray | float, step: float) -> FloatArray:
    """Compute the log-density of a quantised reading: log of its probability over ``step``. Arrays of any shape.

    It tends to the Gaussian log-density of ``reading - predicted`` if ``step`` is much less than ``sd``. Zero for NaN.
    """
    centre, half = np.abs(np.asarray(reading - predicted)) / sd, 0.5 * step / np.asarray(sd)
    upper, lower = log_ndtr(half - centre), log_ndtr(-half - centre)
    with np.errstate(divide="ignore"):
        inside = upper + np.log(-np.expm1(np.minimum(lower - upper, -1e-300)))
    return np.asarray(np.where(np.isfinite(centre), inside - math.log(step), 0.0))


def describe_quantisation(time: FloatArray, readings: FloatArray, fitted: FloatArray) -> Quantisation | None:
    """Describe the quantisation of readings (n,) of a fitted signal (n,); None if they are continuous."""
    step = quantisation_step(readings)
    if step is None:
        return None
    seen = np.isfinite(readings)
    residual = (readings - fitted)[seen]
    error = rounding_error(time, fitted, step, _zero(readings, step))
    variance = max(float(np.mean(residual**2)), 1e-300)
    sd, exact = _noise_before_rounding(readings[seen], fitted[seen], step)
    gaussian = _gaussian_on_grid(residual, math.sqrt(variance), step)
    return Quantisation(step, error, min(1.0, error.sd**2 / variance), sd, exact - gaussian)


def _gaussian_on_grid(residual: FloatArray, sd: float, step: float) -> float:
    """Compute the Gaussian log-likelihood of residuals on a grid of ``step``, normalised to a sum of one over the grid.

    Without normalisation, a constant signal would seem too likely."""
    reach = math.ceil(6.0 * sd / step) + 1
    ladder = step * np.arange(-reach, reach + 1)
    rungs = -0.5 * ((residual[:, None] + ladder) / sd) ** 2
    return float(np.sum(-0.5 * (residual / sd) ** 2 - logsumexp(rungs, axis=1) - math.log(step)))


def _zero(readings: FloatArray, step: float) -> float:
    """Compute the offset of the grid of readings."""
    return float(readings[np.flatnonzero(np.isfinite(readings))[0]]) % step


def _noise_before_rounding(reading: FloatArray, fitted: FloatArray, step: float) -> tuple[float, float]:
    """Compute the maximum likelihood estimate of the standard deviation before rounding, and the log-likelihood."""

    def loss(log_sd: float) -> float:
        return -float(np.sum(interval_log_density(reading, fitted, math.exp(log_sd), step)))

    spread = max(float(np.sqrt(np.mean((reading - fitted) ** 2))), 0.05 * step)
    low, high = math.log(0.01 * step), math.log(3.0 * spread)
    result = scipy.optimize.minimize_scalar(loss, bounds=(low, high), method="bounded", options={"xatol": 1e-4})
    return math.exp(float(result.x)), -float(result.fun)


Json = dict[str, Any]

#: Share of the residual's variance below which quantisation is not reported.
MIN_VARIANCE_SHARE = 1e-3


def describe_sensors(
    outputs: Sequence[str], recordings: Sequence[tuple[FloatArray, FloatArray, FloatArray]]
) -> dict[str, Json]:
    """Describe quantisation by output, as it goes into result.json; times, readings and fit of each recording."""
    found = {
        output: next((c for t, y, f in recordings if (c := _counts(t, y[:, k], f[:, k]))), None)
        for k, output in enumerate(outputs)
    }
    return {output: {"encoder": counts.to_dict()} for output, counts in found.items() if counts is not None}


def _counts(time: FloatArray, readings: FloatArray, fitted: FloatArray) -> Quantisation | None:
    step = quantum(readings)
    if step == 0.0 or step**2 / 12.0 < MIN_VARIANCE_SHARE * float(np.nanmean((readings - fitted) ** 2)):
        return None
    return describe_quantisation(time, readings, fitted)
