"""Noise that is not equally large at each reading: by recording, relative to the reading, or with heavy tails.

A relative noise has the standard deviation ``a + b |y|`` with the predicted reading ``y``, and never shrinks with it.
Noise with heavy tails is a Student t of scale ``s`` and ``nu`` degrees of freedom. Each may have a scale of its own in
each recording, as of two sensors. A fit is told the relative spread of each reading, renewed between fits (iteratively
reweighted least squares; for Student t this is the EM algorithm of Lange, Little and Taylor, 1989, JASA 84, 881).
Which kind a residual has is decided by the density of readings that were left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import scipy  # imports its parts when they are first used
from scipy.special import gammaln

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.noise_estimation import LOG_2PI

SpreadKind = Literal["constant", "relative", "student"]
KINDS: tuple[SpreadKind, ...] = ("constant", "relative", "student")

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
#: Standard deviations at the smallest reading over the growth up to the largest one that are tried.
STARTS = tuple(np.geomspace(1e-6, 32.0, 26).tolist())
#: Steps of the EM algorithm, which converges linearly.
MAX_EM_STEPS = 50


@dataclass(frozen=True)
class SpreadModel:
    """How large the noise of each reading is.

    ``scales`` are factors of its size, one a recording; none where all recordings have the same noise."""

    kind: SpreadKind
    base: float
    per_unit: float = 0.0
    freedom: float = math.inf
    least: float = 0.0
    scales: tuple[float, ...] = ()

    @property
    def equal(self) -> bool:
        """Whether all readings have the same noise."""
        return self.kind == "constant" and not self.scales

    @property
    def widening(self) -> float:
        """Factor of the standard deviation that corrects the information of the weights for heavy tails.

        Student's t has the Fisher information ``(nu + 1) / (nu + 3)`` over that of its weights."""
        return 1.0 if math.isinf(self.freedom) else math.sqrt((self.freedom + 3.0) / (self.freedom + 1.0))

    def log_density(self, residual: FloatArray, predicted: FloatArray, recording: int = 0) -> FloatArray:
        """Compute the log-density (n,) of residuals (n,) of a recording at predicted readings (n,)."""
        sd = self.sd(predicted, recording)
        z = residual / sd
        if self.kind == "student":
            nu = self.freedom
            constant = gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * math.log(nu * math.pi)
            return np.asarray(constant - np.log(sd) - 0.5 * (nu + 1.0) * np.log1p(z * z / nu))
        return np.asarray(-0.5 * (z**2 + LOG_2PI) - np.log(sd))

    def spreads(self, residuals: Sequence[FloatArray], predictions: Sequence[FloatArray]) -> list[FloatArray]:
        """Compute the relative standard deviation (n,) of each reading of each recording.

        For heavy tails the inverse root of its weight."""
        sds = [self.sd(y, k) for k, y in enumerate(predictions)]
        if self.kind == "student":
            nu = self.freedom
            parts = zip(residuals, sds, strict=True)
            return [sd / self.base * np.sqrt((nu + (r / sd) ** 2) / (nu + 1.0)) for r, sd in parts]
        size = math.sqrt(float(np.mean(np.concatenate(sds) ** 2)))
        return [sd / size for sd in sds]

    def sd(self, predicted: FloatArray, recording: int) -> FloatArray:
        """Compute the standard deviation (n,) of readings of a recording at predicted ones (n,)."""
        own = np.maximum(self.base + self.per_unit * np.abs(predicted), self.least)
        return np.asarray(own * self.scales[recording] if self.scales else own)


def estimate_spread(
    kind: SpreadKind, residuals: Sequence[FloatArray], predictions: Sequence[FloatArray], by_recording: bool = False
) -> SpreadModel:
    """Estimate the spread of one kind by maximum likelihood: its shape by a search, its scale at each shape exactly."""
    if kind == "student":
        candidates = [_scaled(SpreadModel(kind, 1.0, freedom=nu), residuals, predictions, by_recording)
                      for nu in FREEDOMS]  # fmt: skip
        return max(candidates, key=lambda m: _total(m, residuals, predictions))
    level = np.abs(np.concatenate(predictions))
    low, high = float(level.min()), float(level.max())
    if kind == "constant" or not high > low:
        return _scaled(SpreadModel("constant", 1.0), residuals, predictions, by_recording)

    def grown(start: float) -> SpreadModel:
        slope = 1.0 / (high - low)
        return _scaled(
            SpreadModel("relative", start - slope * low, slope, least=start), residuals, predictions, by_recording
        )

    def loss(log_start: float) -> float:
        return -_total(grown(math.exp(log_start)), residuals, predictions)

    logs = np.log(STARTS)
    best = int(np.argmin([loss(x) for x in logs.tolist()]))
    bounds = float(logs[max(best - 1, 0)]), float(logs[min(best + 1, logs.size - 1)])
    found = scipy.optimize.minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 0.02})
    return grown(math.exp(float(found.x)))


def _total(model: SpreadModel, residuals: Sequence[FloatArray], predictions: Sequence[FloatArray]) -> float:
    pairs = enumerate(zip(residuals, predictions, strict=True))
    return sum(float(model.log_density(r, y, k).sum()) for k, (r, y) in pairs)


def _scaled(
    shape: SpreadModel, residuals: Sequence[FloatArray], predictions: Sequence[FloatArray], by_recording: bool
) -> SpreadModel:
    """Return a shape with its likeliest scale, over all recordings or for each."""
    relative = [r / shape.sd(y, 0) for r, y in zip(residuals, predictions, strict=True)]
    size = partial(_student_scale, freedom=shape.freedom) if shape.kind == "student" else _rms
    whole = size(np.concatenate(relative))
    scales = tuple(size(z) / whole if z.size else 1.0 for z in relative) if by_recording else ()
    return SpreadModel(
        shape.kind, whole * shape.base, whole * shape.per_unit, shape.freedom, whole * shape.least, scales
    )


def _rms(values: FloatArray) -> float:
    return max(math.sqrt(float(np.mean(values**2))), 1e-300)


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
    """Return the spread that predicts left-out readings best; equal for all unless another one is clearly better."""
    every = -(-sum(r.size for r in residuals) // MAX_SPREAD_READINGS)
    residuals, predictions = [r[::every] for r in residuals], [y[::every] for y in predictions]
    best = estimate_spread("constant", residuals, predictions)
    if sum(r.size for r in residuals) < MIN_SPREAD_READINGS or best.base <= 1e-300:
        return best
    density = _left_out_density(best, residuals, predictions)
    # The kind first, then the recordings, or the other way round: each step has to be clearly better than the last.
    for _ in range(2):
        likelihood, before, most = _total(best, residuals, predictions), density, 0.0
        for model in _next(best, residuals, predictions):
            if _total(model, residuals, predictions) - likelihood < MIN_FITTED_GAIN:
                continue
            left_out = _left_out_density(model, residuals, predictions)
            gain = left_out - before
            total = float(gain.sum())
            if total > MIN_SPREAD_STANDARD_ERRORS * math.sqrt(gain.size * float(np.var(gain))) and total > most:
                best, most, density = model, total, left_out
        if not most:
            break
    return best


def _next(model: SpreadModel, residuals: Sequence[FloatArray], predictions: Sequence[FloatArray]) -> list[SpreadModel]:
    """Return models that differ from one by its kind, or by scales of their own in each recording."""
    scaled = bool(model.scales)
    found = [estimate_spread(k, residuals, predictions, scaled) for k in KINDS if model.kind == "constant" != k]
    if not scaled and sum(r.size >= MIN_SPREAD_READINGS for r in residuals) > 1:
        found.append(estimate_spread(model.kind, residuals, predictions, True))
    return found


def _left_out_density(
    model: SpreadModel, residuals: Sequence[FloatArray], predictions: Sequence[FloatArray]
) -> FloatArray:
    """Compute the log-density (n,) of each reading by an estimate without its block of each recording."""
    found = [np.empty_like(r) for r in residuals]
    blocks = [np.arange(r.size) * BLOCKS // max(r.size, 1) for r in residuals]
    for b in range(BLOCKS):
        rest = estimate_spread(
            model.kind, [r[own != b] for r, own in zip(residuals, blocks, strict=True)],
            [y[own != b] for y, own in zip(predictions, blocks, strict=True)], bool(model.scales),
        )  # fmt: skip
        for k, own in enumerate(blocks):
            found[k][own == b] = rest.log_density(residuals[k][own == b], predictions[k][own == b], k)
    return np.concatenate(found)
