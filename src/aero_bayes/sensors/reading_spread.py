"""Noise that is not equally large at each reading: relative to the reading, or with heavy tails.

A relative noise has the standard deviation ``a + b |y|`` with the predicted reading ``y``. Noise with heavy tails is a
Student t of scale ``s`` and ``nu`` degrees of freedom. Either is told to a fit as the relative spread of each reading,
renewed between fits (iteratively reweighted least squares; for Student t this is the EM algorithm of Lange, Little and
Taylor, 1989, JASA 84, 881). Which kind a residual has is decided by the density of readings that were left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import gammaln

from aero_bayes.arrays import FloatArray
from aero_bayes.sensors.whitening import LOG_2PI

SpreadKind = Literal["constant", "relative", "student"]

#: Blocks that are left out in turn, and readings without which a kind of noise cannot be told.
BLOCKS, MIN_SPREAD_READINGS = 10, 40
#: Standard errors by which a kind has to predict left-out readings better: one false choice in a thousand.
MIN_SPREAD_STANDARD_ERRORS = 3.0
#: Gain in log-likelihood of the fitted readings below which a kind is not tried on left-out ones.
MIN_FITTED_GAIN = 4.0
#: Readings that suffice to choose a kind; of more every n-th is used.
MAX_SPREAD_READINGS = 5000
#: Degrees of freedom that are tried: with fewer than two the variance is infinite, with many the noise is normal.
FREEDOMS = (2.1, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 20.0)
#: Standard deviations at the largest reading over that at the smallest that are tried.
GROWTHS = tuple(np.geomspace(1.0 / 32.0, 32.0, 32).tolist())
#: Steps of the EM algorithm, which converges linearly.
MAX_EM_STEPS = 50


@dataclass(frozen=True)
class SpreadModel:
    """How large the noise of each reading is."""

    kind: SpreadKind
    base: float
    per_unit: float = 0.0
    freedom: float = math.inf
    least: float = 0.0

    @property
    def widening(self) -> float:
        """Factor of the standard deviation that corrects the information of the weights for heavy tails.

        Student's t has the Fisher information ``(nu + 1) / (nu + 3)`` over that of its weights."""
        return 1.0 if math.isinf(self.freedom) else math.sqrt((self.freedom + 3.0) / (self.freedom + 1.0))

    def log_density(self, residual: FloatArray, predicted: FloatArray) -> FloatArray:
        """Compute the log-density (n,) of residuals (n,) at predicted readings (n,)."""
        if self.kind == "student":
            nu, z = self.freedom, residual / self.base
            constant = gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * math.log(nu * math.pi)
            return np.asarray(constant - math.log(self.base) - 0.5 * (nu + 1.0) * np.log1p(z * z / nu))
        sd = self._sd(predicted)
        return np.asarray(-0.5 * ((residual / sd) ** 2 + LOG_2PI) - np.log(sd))

    def spread(self, residual: FloatArray, predicted: FloatArray) -> FloatArray:
        """Compute the relative standard deviation (n,) of each reading.

        For heavy tails the inverse root of its weight."""
        if self.kind == "student":
            z = residual / self.base
            return np.asarray(np.sqrt((self.freedom + z * z) / (self.freedom + 1.0)))
        sd = self._sd(predicted)
        return np.asarray(sd / math.sqrt(float(np.mean(sd**2))))

    def _sd(self, predicted: FloatArray) -> FloatArray:
        return np.maximum(self.base + self.per_unit * np.abs(predicted), self.least)


def estimate_spread(kind: SpreadKind, residual: FloatArray, predicted: FloatArray) -> SpreadModel:
    """Estimate the spread of one kind by maximum likelihood, over a grid of its shape.

    The scale at each shape is exact."""
    rms = max(math.sqrt(float(np.mean(residual**2))), 1e-300)
    if kind == "constant":
        return SpreadModel("constant", rms)
    if kind == "student":
        models = [SpreadModel("student", _student_scale(residual, nu), freedom=nu) for nu in FREEDOMS]
    else:
        level = np.abs(predicted)
        low, high = float(level.min()), float(level.max())
        if not high > low:
            return SpreadModel("constant", rms)
        place, models = (level - low) / (high - low), []
        for ratio in GROWTHS:
            first = max(math.sqrt(float(np.mean((residual / (1.0 + (ratio - 1.0) * place)) ** 2))), 1e-300)
            slope = first * (ratio - 1.0) / (high - low)
            models.append(SpreadModel("relative", first - slope * low, slope, least=first * min(ratio, 1.0)))
    return max(models, key=lambda m: float(m.log_density(residual, predicted).sum()))


def _student_scale(residual: FloatArray, freedom: float) -> float:
    """Scale of Student's t at given degrees of freedom, by the EM algorithm."""
    square = residual**2
    scale = max(float(np.median(square)), 1e-12 * float(np.mean(square)), 1e-300)
    for _ in range(MAX_EM_STEPS):
        new = max((freedom + 1.0) * float(np.mean(square / (freedom + square / scale))), 1e-300)
        done = abs(new - scale) < 1e-4 * scale
        scale = new
        if done:
            break
    return math.sqrt(scale)


def choose_spread(residuals: Sequence[FloatArray], predictions: Sequence[FloatArray]) -> SpreadModel:
    """Return the kind of spread that predicts left-out readings best; constant unless another one is clearly better."""
    residual, predicted = np.concatenate(residuals), np.concatenate(predictions)
    every = -(-residual.size // MAX_SPREAD_READINGS)
    residual, predicted = residual[::every], predicted[::every]
    best = constant = estimate_spread("constant", residual, predicted)
    if residual.size < MIN_SPREAD_READINGS or constant.base <= 1e-300:
        return constant
    present, most = float(constant.log_density(residual, predicted).sum()), 0.0
    kinds: tuple[SpreadKind, ...] = ("relative", "student")
    for kind in kinds:
        model = estimate_spread(kind, residual, predicted)
        if float(model.log_density(residual, predicted).sum()) - present < MIN_FITTED_GAIN:
            continue
        gain = _left_out_density(kind, residual, predicted) - _left_out_density("constant", residual, predicted)
        total = float(gain.sum())
        if total > MIN_SPREAD_STANDARD_ERRORS * math.sqrt(residual.size * float(np.var(gain))) and total > most:
            best, most = model, total
    return best


def _left_out_density(kind: SpreadKind, residual: FloatArray, predicted: FloatArray) -> FloatArray:
    """Compute the log-density (n,) of each reading by an estimate without its block."""
    found = np.empty_like(residual)
    for block in np.array_split(np.arange(residual.size), BLOCKS):
        rest = np.ones(residual.size, dtype=bool)
        rest[block] = False
        model = estimate_spread(kind, residual[rest], predicted[rest])
        found[block] = model.log_density(residual[block], predicted[block])
    return found
