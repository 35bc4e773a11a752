"""Laplace approximation of the posterior, and how much wider it is where the residual is no noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import polar

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.block_jackknife import jackknife_covariance
from aero_bayes.estimate.gaussian import parameter_covariance
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.target import CurvatureAdjustment, NoiseLayout
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.sensors.whitening import log_density


@dataclass(frozen=True)
class Laplace:
    """Mean (d,) and covariance (d, d) of free parameters, then noise parameters; ``names`` in that order.

    Mean and covariance of a Gaussian are orthogonal parameters, so the two blocks do not mix."""

    names: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray
    parameters: int

    @property
    def sd(self) -> FloatArray:
        return np.sqrt(np.diag(self.covariance))

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw from the Gaussian in search coordinates, shape (count, d)."""
        sizes, axes = np.linalg.eigh(self.covariance)
        return np.asarray(
            self.mean + rng.standard_normal((count, self.mean.size)) * np.sqrt(np.maximum(sizes, 0.0)) @ axes.T
        )


def curvature_adjustment(objective: Objective, optimum: Optimum) -> CurvatureAdjustment | None:
    """Return how much wider than its likelihood the posterior is.

    None where noise describes the residuals of all outputs."""
    if not optimum.free or not any(optimum.noise[s.output].model_error for s in objective.series):
        return None
    items = [objective.parameters.items[j] for j in optimum.free]
    unit = ParameterSet(tuple(items)).prior_sd()
    slopes = optimum.whitened.slopes * unit[:, None]
    own = np.array([item.recording is not None for item in items])
    # With the own parameters readjusted to each change of the shared ones.
    follow = -np.linalg.pinv(slopes[own] @ slopes[own].T, hermitian=True) @ (slopes[own] @ slopes[~own].T)
    shared = slopes[~own] + follow.T @ slopes[own]
    values, vectors = np.linalg.eigh(shared @ shared.T)
    seen = values > 1e-10 * max(float(values.max(initial=0.0)), 1e-300)
    axes, root = vectors[:, seen], np.sqrt(values[seen])
    covariance = jackknife_covariance(objective.series, (axes / root).T @ shared, optimum.whitened.residual)
    sizes, directions = np.linalg.eigh(covariance)
    sizes = np.maximum(sizes, 1.0)
    narrowed = (
        np.eye(len(values))
        + (axes / root) @ ((directions / np.sqrt(sizes)) @ directions.T - np.eye(len(sizes))) @ (axes * root).T
    )
    adjusted = np.zeros((len(items), len(items)))
    kept = 1.0 / np.sqrt(np.median(sizes)) if sizes.size else 1.0
    adjusted[np.ix_(~own, ~own)] = narrowed
    adjusted[np.ix_(own, own)] = kept * np.eye(int(own.sum()))
    adjusted[np.ix_(own, ~own)] = follow @ narrowed - kept * follow
    # Of all maps M with M' H M = H' (H before, H' after), the symmetric one moves points least: optimal transport
    # between Gaussians (Olkin & Pukelsheim, 1982, Linear Algebra Appl. 48, 257). As H' <= H, it only contracts. Others
    # carry what a strong direction moves into a weak one, far beyond the prior.
    values, vectors = np.linalg.eigh(slopes @ slopes.T)
    full = np.where(values > 1e-10 * max(float(values.max(initial=0.0)), 1e-300), np.sqrt(np.maximum(values, 0.0)), 1.0)
    stretch = polar((vectors * full) @ vectors.T @ adjusted @ (vectors * full) @ vectors.T)[1]
    inverse = (vectors / full) @ vectors.T
    scaled = inverse @ stretch @ inverse
    return CurvatureAdjustment(optimum.coordinates[list(optimum.free)], scaled * unit[:, None] / unit[None, :])


def widened_covariance(objective: Objective, optimum: Optimum) -> FloatArray:
    """Compute the covariance of the free columns' posterior, in search coordinates."""
    items = ParameterSet(tuple(objective.parameters.items[j] for j in optimum.free))
    information = optimum.whitened.information
    if (spread := curvature_adjustment(objective, optimum)) is not None:
        information = spread.map.T @ information @ spread.map
    second = items.prior_derivatives(optimum.coordinates[list(optimum.free)])[1]
    return parameter_covariance(information + items.prior_curvature(second, range(len(items))), items.prior_sd())


def with_robust_covariance(objective: Objective, optimum: Optimum) -> Optimum:
    """Return the optimum with the covariance that its residuals ask for, where they are no noise."""
    wrong = any(optimum.noise[s.output].model_error for s in objective.series)
    return replace(optimum, covariance=widened_covariance(objective, optimum)) if wrong else optimum


def noise_covariance(
    layout: NoiseLayout,
    times: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    noise: Mapping[str, OutputNoise],
    step: float = 0.02,
) -> FloatArray:
    """Compute the covariance of the noise parameters' logarithms, from second differences of their log-posterior."""
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
    # Where a run fails a density may not be finite: the prior's width is what is left.
    values, vectors = np.linalg.eigh(np.where(np.isfinite(hessian), hessian, 0.0))
    floor = 1.0 / layout.sigma**2
    return np.asarray((vectors / np.maximum(values, floor)) @ vectors.T)
