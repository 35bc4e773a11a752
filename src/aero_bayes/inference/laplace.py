"""The Gaussian that touches the posterior at its mode, in search coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.inference.noise import NoiseEstimate, log_density
from aero_bayes.inference.target import NoiseLayout

FloatArray = NDArray[np.float64]


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


def noise_covariance(
    layout: NoiseLayout,
    times: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    noise: dict[str, NoiseEstimate],
    step: float = 0.02,
) -> FloatArray:
    """Covariance of the logarithms of the noise parameters, from second differences of their log-posterior."""
    centre = layout.pack(noise)
    size = layout.size
    hessian = np.zeros((size, size))
    owner = [name.split(".")[1] for name in layout.names]

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
