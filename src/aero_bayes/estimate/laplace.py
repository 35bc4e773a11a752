"""Laplace approximation of the posterior, and its sandwich covariance where the residual is not white noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.target import CurvatureAdjustment, NoiseLayout
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.sensors.whitening import log_density

FloatArray = NDArray[np.float64]

#: Bandwidth of the residual's autocovariance, in its effective correlation lengths and as a share of the readings.
BANDWIDTH_LENGTHS, MAX_BANDWIDTH_SHARE = 8.0, 0.25


@dataclass(frozen=True)
class Laplace:
    """Mean (d,) and covariance (d, d) of free parameters, then noise parameters; ``names`` in that order.

    Mean and covariance of a Gaussian are orthogonal parameters, so the two blocks do not mix.
    """

    names: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray
    parameters: int

    @property
    def sd(self) -> FloatArray:
        return np.sqrt(np.diag(self.covariance))


def parameter_covariance(hessian: FloatArray, prior_sd: FloatArray) -> FloatArray:
    """Inverse of a Hessian that contains the priors; a direction flatter than its prior gets the prior's width."""
    scaled = hessian * prior_sd[:, None] * prior_sd[None, :]
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    inverse = (vectors / np.maximum(values, 1.0)) @ vectors.T
    return np.asarray(inverse * prior_sd[:, None] * prior_sd[None, :])


def curvature_adjustment(
    series: Sequence[Series], optimum: Optimum, prior_sd: FloatArray
) -> CurvatureAdjustment | None:
    """Curvature adjustment by the sandwich covariance; None where the noise of all outputs describes their residuals.

    With whitened slopes S and residuals of correlation R, the estimate's covariance is the sandwich (S S')^-1 S R S'
    (S S')^-1 (White, 1982, Econometrica 50, 1; Newey & West, 1987, Econometrica 55, 703). It is never narrower
    than that of independent readings.

    Parameters
    ----------
    series : sequence of Series
        Of the objective that was fitted.
    optimum : Optimum
    prior_sd : ndarray, shape (f,)
        Standard deviation of the free columns' priors in search coordinates; only sets the scale.
    """
    if not any(optimum.noise[s.output].model_error for s in series):
        return None
    count = len(optimum.free)
    bread, meat = np.zeros((count, count)), np.zeros((count, count))
    position = 0
    for s in series:
        here = slice(position, position + s.sampling.size)
        slopes = optimum.whitened.slopes[:, here] * prior_sd[:, None]
        residual = optimum.whitened.residual[here]
        position = here.stop
        own = slopes @ slopes.T
        bread += own
        meat += slopes @ _correlated(slopes, residual).T if optimum.noise[s.output].model_error else own
    values, vectors = np.linalg.eigh(bread)
    seen = values > 1e-10 * max(float(values[-1]), 1e-300)
    root = np.where(seen, np.sqrt(np.maximum(values, 0.0)), 1.0)
    half = np.where(seen, 1.0 / root, 0.0)
    middle = (vectors * half) @ vectors.T @ meat @ (vectors * half) @ vectors.T
    sizes, axes = np.linalg.eigh(0.5 * (middle + middle.T))
    shrink = (axes / np.sqrt(np.maximum(sizes, 1.0))) @ axes.T
    full = np.where(seen, root, 1.0)
    scaled = ((vectors / full) @ vectors.T) @ shrink @ ((vectors * full) @ vectors.T)
    return CurvatureAdjustment(optimum.coordinates[list(optimum.free)], scaled * prior_sd[:, None] / prior_sd[None, :])


def _correlated(slopes: FloatArray, residual: FloatArray) -> FloatArray:
    """Slopes (k, n) times the autocovariance of a residual (n,), by FFT, its far lags tapered away (Parzen)."""
    n = residual.size
    size = 1 << (2 * n - 1).bit_length()
    covariance = np.fft.irfft(np.abs(np.fft.rfft(residual, size)) ** 2, size)[:n] / n
    rho = covariance / max(float(covariance[0]), 1e-300)
    limit = max(int(MAX_BANDWIDTH_SHARE * n), 1)
    length = float(np.sum(rho[:limit] ** 2))
    lags = np.arange(n) / min(max(BANDWIDTH_LENGTHS * length, 2.0), limit)
    taper = np.where(lags <= 0.5, 1.0 - 6.0 * lags**2 + 6.0 * lags**3, 2.0 * np.clip(1.0 - lags, 0.0, None) ** 3)
    kernel = np.zeros(size)
    kernel[:n] = taper * covariance
    kernel[size - n + 1 :] = (taper * covariance)[:0:-1]
    product = np.fft.irfft(np.fft.rfft(slopes, size, axis=1) * np.fft.rfft(kernel), size, axis=1)
    return np.asarray(product[:, :n])


def noise_covariance(
    layout: NoiseLayout,
    times: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    noise: Mapping[str, OutputNoise],
    step: float = 0.02,
) -> FloatArray:
    """Covariance of the logarithms of the noise parameters, from second differences of their log-posterior."""
    centre = layout.pack(noise)
    size = layout.size
    hessian = np.zeros((size, size))
    owner = [name.removeprefix("noise.").rpartition(".")[0] for name in layout.names]

    def value(output: str, point: FloatArray) -> float:
        k = layout.outputs.index(output)
        estimate = layout.estimates(point)[output]
        density = sum(log_density(t, r[:, k], estimate) for t, r in zip(times, residuals, strict=True))
        return density + float(layout.log_prior(point[None])[0])

    for a in range(size):
        for b in range(a + 1):
            if owner[a] != owner[b]:
                continue
            ea, eb = step * np.eye(size)[a], step * np.eye(size)[b]
            corners = [value(owner[a], centre + sa * ea + sb * eb) for sa in (1, -1) for sb in (1, -1)]
            hessian[a, b] = hessian[b, a] = -(corners[0] - corners[1] - corners[2] + corners[3]) / (4.0 * step**2)
    values, vectors = np.linalg.eigh(hessian)
    floor = 1.0 / layout.sigma**2
    return np.asarray((vectors / np.maximum(values, floor)) @ vectors.T)
