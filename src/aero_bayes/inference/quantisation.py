"""Readings of an encoder: what its counts add to the noise, and the exact likelihood where they matter.

A reading r on a grid of step q says that the noisy angle lay within q/2 of r. With white noise the probability of that
is a difference of two normal distributions; for noise much larger than q it is the Gaussian density times q, to which
q^2/12 of variance may be added (Sheppard). With less noise the Gaussian is wrong in shape, and the error of a slow
motion is not white: neighbouring readings share it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr, logsumexp

from aero_bayes.data.noise import quantisation_step
from aero_bayes.errors import InputError
from aero_bayes.inference.noise import NoiseEstimate, estimate_noise
from aero_bayes.inference.result import Fit
from aero_bayes.inference.target import JointTarget

FloatArray = NDArray[np.float64]
_LOG_2PI = math.log(2.0 * math.pi)

#: Gain in log-likelihood at which the exact likelihood of counts is preferred over the Gaussian one.
LEAST_GAIN = 3.0
#: Draws simulated at once, so that trajectories stay within memory.
BATCH = 64


@dataclass(frozen=True)
class Quantisation:
    """An encoder as the residual shows it.

    ``step`` is its quantum; ``error`` the error that rounding alone makes of the fitted signal (its size, and how long
    it lasts); ``share`` that error's part of the residual's variance; ``sd`` the noise before rounding, by the exact
    likelihood; ``gain`` that likelihood's gain over the Gaussian one.
    """

    step: float
    error: NoiseEstimate
    share: float
    sd: float
    gain: float

    @property
    def exact(self) -> bool:
        """Whether the exact likelihood describes the readings noticeably better than the Gaussian one."""
        return self.gain > LEAST_GAIN

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


def rounding_error(time: FloatArray, fitted: FloatArray, step: float, zero: float = 0.0) -> NoiseEstimate:
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


def describe_counts(fit: Fit, output: str, recording: int = 0) -> Quantisation | None:
    """What an encoder does to one output of a fit; None where its readings are continuous.

    Raises
    ------
    InputError
        If the output was not fitted.
    """
    if output not in fit.outputs:
        raise InputError(f"{output} was not fitted; the fit has {', '.join(fit.outputs)}")
    column = fit.outputs.index(output)
    return counts_of(
        fit.calibration.experiments[recording].time,
        fit.calibration.measured[recording][:, column],
        fit.fitted[recording][:, column],
    )


def counts_of(time: FloatArray, readings: FloatArray, fitted: FloatArray) -> Quantisation | None:
    """What an encoder does to readings (n,) of a signal (n,); None where they are continuous."""
    step = quantisation_step(readings)
    if step is None:
        return None
    seen = np.isfinite(readings)
    residual = (readings - fitted)[seen]
    error = rounding_error(time, fitted, step, _zero(readings, step))
    variance = max(float(np.mean(residual**2)), 1e-300)
    sd, exact = _noise_before_rounding(readings[seen], fitted[seen], step)
    gaussian = _on_the_grid(residual, math.sqrt(variance), step)
    return Quantisation(step, error, min(1.0, error.sd**2 / variance), sd, exact - gaussian)


def encoder_density(joint: JointTarget, steps: Mapping[str, float]) -> EncoderDensity:
    """The posterior of a fit with the exact likelihood of some outputs' counts in place of the Gaussian one."""
    return EncoderDensity(joint, dict(steps))


class EncoderDensity:
    """Log-posterior in which outputs in ``steps`` (quanta by name) have the exact likelihood of their counts.

    The noise's white standard deviation is then that before rounding. Outputs with correlated noise cannot be treated
    so: their counts are no longer independent.

    Raises
    ------
    InputError
        For an output that was not fitted, or whose noise is correlated.
    """

    def __init__(self, joint: JointTarget, steps: Mapping[str, float]) -> None:
        self.joint, self.steps = joint, steps
        self.names = joint.names
        outputs = joint.target.calibration.outputs
        for name in steps:
            if name not in outputs:
                raise InputError(f"{name} was not fitted; the fit has {', '.join(outputs)}")
            if f"noise.{name}.sd_ou" in joint.names or f"noise.{name}.sd_white" not in joint.names:
                raise InputError(f"{name}: counts have an exact likelihood only where the noise is white")

    @property
    def dimension(self) -> int:
        return self.joint.dimension

    def __call__(self, points: FloatArray) -> FloatArray:
        """Log-posterior, shape (n,), at points (n, d)."""
        points = np.asarray(points, dtype=np.float64)
        total = self.joint(points)
        for first in range(0, len(points), BATCH):
            part = np.arange(first, min(first + BATCH, len(points)))
            part = part[np.isfinite(total[part])]
            if part.size:
                total[part] += self._difference(points[part])
        return total

    def _difference(self, points: FloatArray) -> FloatArray:
        """Exact minus Gaussian log-likelihood of the counted outputs, shape (n,)."""
        target = self.joint.target
        f = len(target.free)
        result = target.simulator.simulate(target.values(points[:, :f]))
        total = np.zeros(len(points))
        for name, step in self.steps.items():
            column = target.calibration.outputs.index(name)
            sd = np.exp(points[:, self.names.index(f"noise.{name}.sd_white")])[:, None]
            for measured, outputs in zip(target.calibration.measured, result.outputs, strict=True):
                reading, predicted = measured[None, :, column], outputs[:, :, column]
                z = (reading - predicted) / sd
                gaussian = np.where(np.isfinite(z), -0.5 * (z**2 + _LOG_2PI) - np.log(sd), 0.0)
                total += np.sum(interval_log_density(reading, predicted, sd, step) - gaussian, axis=1)
        return np.where(np.isnan(total), -np.inf, total)


def _on_the_grid(residual: FloatArray, sd: float, step: float) -> float:
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
