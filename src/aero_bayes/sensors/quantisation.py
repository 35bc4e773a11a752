"""Readings of an encoder: what its counts add to the noise, and the exact likelihood where they matter.

A reading r on a grid of step q says that the noisy angle lay within q/2 of r. With white noise the probability of that
is a difference of two normal distributions; for noise much larger than q it is the Gaussian density times q, to which
q^2/12 of variance may be added (Sheppard). With less noise the Gaussian is wrong in shape, and the error of a slow
motion is not white: neighbouring readings share it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr, logsumexp

from aero_bayes.data.noise import quantisation_step
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.sensors.noise_estimation import estimate_noise

FloatArray = NDArray[np.float64]

#: Gain in log-likelihood at which the exact likelihood of counts is preferred over the Gaussian one.
MIN_LOG_LIKELIHOOD_GAIN = 3.0


def quantum(values: FloatArray) -> float:
    """Step between neighbouring readings that lie on a grid (an encoder's count), else 0."""
    return quantisation_step(values) or 0.0


def thin_constant_readings(
    time: FloatArray, values: FloatArray, longest: float = 0.5, keep: int = 3, spacing: float = 2.5
) -> NDArray[np.bool_]:
    """Which readings to keep so that a reading which stands still does not count over and over.

    Of a stretch of equal readings longer than ``longest`` s one every ``spacing`` s is kept, at least ``keep``, evenly
    spread.
    """
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
    """An encoder as the residual shows it.

    ``step`` is its quantum; ``error`` the error that rounding alone makes of the fitted signal (its size, and how long
    it lasts); ``share`` that error's part of the residual's variance; ``sd`` the noise before rounding, by the exact
    likelihood; ``gain`` that likelihood's gain over the Gaussian one.
    """

    step: float
    error: OutputNoise
    share: float
    sd: float
    gain: float

    @property
    def exact(self) -> bool:
        """Whether the exact likelihood describes the readings noticeably better than the Gaussian one."""
        return self.gain > MIN_LOG_LIKELIHOOD_GAIN

    def to_dict(self) -> dict[str, float | bool]:
        return {
            "step": self.step,
            "error_sd": self.error.sd,
            "error_lasts_s": self.error.tau,
            "share": self.share,
            "sd_before_rounding": self.sd,
            "gain": self.gain,
            "exact": self.exact,
        }


def rounding_error(time: FloatArray, fitted: FloatArray, step: float, zero: float = 0.0) -> OutputNoise:
    """Size and correlation of the error that rounding makes of a signal (n,): the least noise an encoder has.

    A signal that crosses many counts between samples has white error of ``step / sqrt(12)``; a slow one has error that
    lasts as long as a count does.
    """
    error = zero + step * np.round((fitted - zero) / step) - fitted
    return estimate_noise([time], [error], "auto")


def interval_log_density(reading: FloatArray, predicted: FloatArray, sd: FloatArray | float, step: float) -> FloatArray:
    """Log of the probability that noise of ``sd`` rounds ``predicted`` to ``reading``, over ``step``; any shape.

    Comparable with a Gaussian log-density, to which it tends where ``step`` is small against ``sd``. Zero for NaN.
    """
    centre, half = np.abs(np.asarray(reading - predicted)) / sd, 0.5 * step / np.asarray(sd)
    upper, lower = log_ndtr(half - centre), log_ndtr(-half - centre)
    with np.errstate(divide="ignore"):
        inside = upper + np.log(-np.expm1(np.minimum(lower - upper, -1e-300)))
    return np.asarray(np.where(np.isfinite(centre), inside - math.log(step), 0.0))


def describe_quantisation(time: FloatArray, readings: FloatArray, fitted: FloatArray) -> Quantisation | None:
    """What an encoder does to readings (n,) of a signal (n,); None where they are continuous."""
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
    """Gaussian log-likelihood of residuals that can only lie ``step`` apart, normalised over where they can lie.

    A density taken at the counts alone would not sum to one, and a signal at rest on a count would seem too likely.
    """
    reach = math.ceil(6.0 * sd / step) + 1
    ladder = step * np.arange(-reach, reach + 1)
    rungs = -0.5 * ((residual[:, None] + ladder) / sd) ** 2
    return float(np.sum(-0.5 * (residual / sd) ** 2 - logsumexp(rungs, axis=1) - math.log(step)))


def _zero(readings: FloatArray, step: float) -> float:
    """Where the grid of counts lies: a reading, as good as any."""
    return float(readings[np.flatnonzero(np.isfinite(readings))[0]]) % step


def _noise_before_rounding(reading: FloatArray, fitted: FloatArray, step: float) -> tuple[float, float]:
    """Most likely standard deviation under the exact likelihood, and that log-likelihood."""

    def loss(log_sd: float) -> float:
        return -float(np.sum(interval_log_density(reading, fitted, math.exp(log_sd), step)))

    spread = max(float(np.sqrt(np.mean((reading - fitted) ** 2))), 0.05 * step)
    low, high = math.log(0.01 * step), math.log(3.0 * spread)
    result = minimize_scalar(loss, bounds=(low, high), method="bounded", options={"xatol": 1e-4})
    return math.exp(float(result.x)), -float(result.fun)
