"""Refit of a model with its noise: damped Gauss-Newton steps in turn with a new estimate of the noise.

Each model under comparison gets its own most likely noise, so that evidence is a ratio of likelihoods in which a
thousand correlated samples do not count as a thousand. The noise also weighs the outputs: a pitch that the model cannot
follow has a large, slow noise and no longer drags the motor's parameters with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.discrepancy.study import Evaluation, Study, Whitened
from aero_bayes.discrepancy.whitening import BinnedPower, OutputNoise, estimate_noise
from aero_bayes.errors import CannotFinishError
from aero_bayes.inference.parameters import ParameterSet

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SmoothPrior:
    """A joint normal prior of zero mean for the values of a learned curve, in place of their own.

    ``covariance`` (k, k) is over the values of the parameters ``names``, in their squared unit.
    """

    names: tuple[str, ...]
    covariance: FloatArray

    def terms(self, parameters: ParameterSet, x: FloatArray) -> tuple[list[int], float, FloatArray, FloatArray]:
        """Columns, log-density in search coordinates, its gradient (k,) and the curvature (k, k) of its negative."""
        columns = [parameters.index(name) for name in self.names]
        values = parameters.from_search(x)
        slope = parameters.jacobian(values)[columns]
        factor = np.linalg.cholesky(self.covariance)
        precision = np.linalg.inv(self.covariance)
        white = np.linalg.solve(factor, values[columns])
        density = -0.5 * float(white @ white) - float(np.sum(np.log(np.diag(factor) / slope)))
        density -= 0.5 * len(columns) * math.log(2.0 * math.pi)
        return columns, density, -slope * (precision @ values[columns]), precision * np.outer(slope, slope)


@dataclass(frozen=True)
class RefitSettings:
    """When a refit stops, and what the noise may be.

    ``tolerance`` is the gain in log-posterior that is not worth another step. ``floors`` are least standard deviations
    of the white noise by output (a sensor's quantum over the square root of twelve); ``longest`` is the greatest
    correlation time in s.
    """

    iterations: int = 25
    tolerance: float = 0.02
    floors: Mapping[str, float] | None = None
    longest: float = 1.0
    hold_noise: bool = False
    smooth: SmoothPrior | None = None


@dataclass(frozen=True, eq=False)
class Refit:
    """A local optimum of the log-posterior over the free columns, and Laplace's approximation there.

    ``coordinates`` (p,) are search coordinates of all columns; ``covariance`` is over the ``free`` ones.
    """

    free: tuple[int, ...]
    coordinates: FloatArray
    noise: Mapping[str, OutputNoise]
    log_likelihood: float
    log_prior: float
    log_evidence: float
    covariance: FloatArray
    evaluation: Evaluation
    whitened: Whitened
    converged: bool
    steps: int

    def sd(self, column: int) -> float:
        """Standard deviation of a free column's search coordinate."""
        k = self.free.index(column)
        return math.sqrt(max(float(self.covariance[k, k]), 0.0))


def noise_of(
    study: Study,
    residual: Sequence[FloatArray],
    settings: RefitSettings,
    start: Mapping[str, OutputNoise] | None = None,
) -> dict[str, OutputNoise]:
    """Most likely noise of every output, its recordings pooled."""
    floors = settings.floors or {}
    noise = {}
    for output in study.outputs:
        powers = [
            BinnedPower.of(residual[k], series.sampling)
            for k, series in enumerate(study.series)
            if series.output == output
        ]
        noise[output] = estimate_noise(
            powers,
            floor=floors.get(output, 0.0),
            longest=settings.longest,
            start=start.get(output) if start is not None else None,
        )
    return noise


def refit(
    study: Study,
    start: FloatArray,
    free: Sequence[int],
    *,
    noise: Mapping[str, OutputNoise] | None = None,
    settings: RefitSettings | None = None,
) -> Refit:
    """Climb from ``start`` (search coordinates of all columns) over the ``free`` columns.

    Raises
    ------
    CannotFinishError
        If the model cannot be simulated at the start.
    """
    settings = settings or RefitSettings()
    smooth = settings.smooth
    free = tuple(free)
    columns = list(free)
    low, high = (bound[columns] for bound in study.parameters.box)
    x = np.array(start, dtype=np.float64)
    x[columns] = np.clip(x[columns], low, high)
    found = study.evaluate(x, free)
    if found is None:
        raise CannotFinishError("the model cannot be simulated at the values where a fit starts")
    noise = dict(noise) if noise is not None else noise_of(study, found.residual, settings)
    damping = 1e-3
    converged = False
    step_count = 0
    white = study.whiten(found.residual, found.slopes, noise)
    value = white.log_likelihood + _log_prior(study, x, columns, smooth)
    for step_count in range(1, settings.iterations + 1):  # noqa: B007
        gradient, curvature = _posterior_slopes(study, white, x, columns, smooth)
        moved = False
        predicted = 0.0
        for _ in range(8):
            step = _bounded_step(gradient, curvature, damping, x[columns], low, high)
            predicted = float(step @ gradient - 0.5 * step @ curvature @ step)
            if predicted < settings.tolerance:
                break
            trial = x.copy()
            trial[columns] = np.clip(x[columns] + step, low, high)
            there = study.evaluate(trial, free)
            if there is not None:
                at = study.whiten(there.residual, there.slopes, noise)
                gain = at.log_likelihood + _log_prior(study, trial, columns, smooth) - value
                if gain > 0.0:
                    x, found, white, value = trial, there, at, value + gain
                    damping = max(damping * (0.1 if gain > 0.5 * predicted else 1.0), 1e-9)
                    moved = True
                    break
            damping = max(damping * 8.0, 1e-4)
        gained = 0.0
        if not settings.hold_noise:
            renewed = noise_of(study, found.residual, settings, noise)
            again = study.whiten(found.residual, found.slopes, renewed)
            after = again.log_likelihood + _log_prior(study, x, columns, smooth)
            gained = after - value
            if gained > 0.0:
                noise, white, value = renewed, again, after
        if not moved and gained < 0.1:
            converged = predicted < settings.tolerance
            break
    return finish(study, x, free, noise, found, white, smooth=smooth, converged=converged, steps=step_count)


def finish(
    study: Study,
    x: FloatArray,
    free: Sequence[int],
    noise: Mapping[str, OutputNoise],
    found: Evaluation,
    white: Whitened,
    *,
    smooth: SmoothPrior | None,
    converged: bool,
    steps: int,
) -> Refit:
    """Laplace's approximation of the evidence at an optimum."""
    columns = list(free)
    _, curvature = _posterior_slopes(study, white, x, columns, smooth)
    values, vectors = np.linalg.eigh(curvature)
    values = np.maximum(values, 1e-12 * max(float(values[-1]), 1.0)) if len(columns) else values
    covariance = (vectors / values) @ vectors.T
    prior = _log_prior(study, x, columns, smooth)
    occam = 0.5 * len(columns) * math.log(2.0 * math.pi) - 0.5 * float(np.sum(np.log(values)))
    likelihood = white.log_likelihood
    return Refit(
        tuple(free), x, dict(noise), likelihood, prior, likelihood + prior + occam, covariance, found, white,
        converged, steps,
    )  # fmt: skip


def _log_prior(study: Study, x: FloatArray, columns: Sequence[int], smooth: SmoothPrior | None) -> float:
    """Log-density of the free columns' priors in search coordinates (fixed ones are not counted)."""
    parameters = study.parameters
    values = parameters.from_search(x)
    slopes = parameters.jacobian(values)
    coupled: list[int] = []
    total = 0.0
    if smooth is not None:
        coupled, total, _, _ = smooth.terms(parameters, x)
    for j in columns:
        if j not in coupled:
            total += float(parameters.items[j].prior.log_pdf(values[j])) + math.log(float(slopes[j]))
    return total


def _posterior_slopes(
    study: Study, white: Whitened, x: FloatArray, columns: Sequence[int], smooth: SmoothPrior | None
) -> tuple[FloatArray, FloatArray]:
    """Gradient of the log-posterior and the Gauss-Newton curvature of its negative."""
    first, second = study.parameters.prior_derivatives(x)
    curvature = np.diag(np.maximum(-second, 1e-9))
    if smooth is not None:
        coupled, _, gradient, block = smooth.terms(study.parameters, x)
        first[coupled] = gradient
        curvature[np.ix_(coupled, coupled)] = block
    chosen = list(columns)
    return white.slopes @ white.residual + first[chosen], white.slopes @ white.slopes.T + curvature[
        np.ix_(chosen, chosen)
    ]


def _bounded_step(
    gradient: FloatArray, curvature: FloatArray, damping: float, x: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Damped Newton step that stays in the box: coordinates that would leave it are held at the bound, in turn."""
    held = ((x <= low) & (gradient < 0.0)) | ((x >= high) & (gradient > 0.0))
    step = np.zeros_like(x)
    damped = curvature + damping * np.diag(np.diag(curvature))
    for _ in range(x.size + 1):
        loose = ~held
        if not loose.any():
            return step
        right = gradient[loose] - damped[np.ix_(loose, held)] @ step[held]
        step[loose] = np.linalg.solve(damped[np.ix_(loose, loose)], right)
        beyond = loose & ((x + step < low) | (x + step > high))
        if not beyond.any():
            return step
        step[beyond] = np.clip(x + step, low, high)[beyond] - x[beyond]
        held = held | beyond
    return step
