"""A Student t density over transformed coordinates: an approximation of a density, to propose from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln

from aero_bayes.arrays import FloatArray
from aero_bayes.sampling.moves.triangular_map import TriangularMap
from aero_bayes.sampling.moves.warp import Warp


@dataclass(frozen=True, eq=False)
class WarpedStudentT:
    """Multivariate t density of whitened and transformed coordinates.

    A draw is ``mean + factor @ triangular^-1(warp^-1(t))`` with t, the *scores*, from the standard multivariate t of
    ``dof`` degrees of freedom; ``mean`` is (d,), ``factor`` (d, d)."""

    mean: FloatArray
    factor: FloatArray
    dof: float
    warp: Warp
    triangular: TriangularMap
    axes: FloatArray

    @classmethod
    def of(
        cls, mean: FloatArray, covariance: FloatArray, dof: float = 8.0, axes: FloatArray | None = None
    ) -> WarpedStudentT:
        """Make the t density whose scale matrix is a covariance, made safely positive definite."""
        d = len(mean)
        axes = np.eye(d) if axes is None else axes
        covariance = axes @ covariance @ axes.T
        sd = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(sd, sd)
        values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
        safe = (vectors * np.maximum(values, 1e-10)) @ vectors.T
        factor = np.linalg.solve(axes, sd[:, None] * np.linalg.cholesky(safe))
        return cls(np.array(mean), factor, dof, Warp.identity(d), TriangularMap.identity(d), axes)

    @classmethod
    def fit(
        cls, samples: FloatArray, dof: float = 8.0, *, axes: FloatArray | None = None, curved: bool = False
    ) -> WarpedStudentT:
        """Fit to samples (n, d): by their mean and covariance, and by quantiles where a margin is not normal."""
        axes = np.eye(samples.shape[1]) if axes is None else axes
        along = samples @ axes.T
        order = np.argsort(-Warp.departure((along - along.mean(axis=0)) / np.std(along, axis=0)), kind="stable")
        plain = cls.of(samples.mean(axis=0), np.atleast_2d(np.cov(samples.T)), dof, axes[order])
        scores = plain.scores(samples)[0]
        triangular = TriangularMap.fit(scores) if curved else plain.triangular
        return replace(plain, triangular=triangular, warp=Warp.fit(triangular.forward(scores)), axes=axes)

    def scores(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return scores of points (n, d), and the log-determinant of the transformation, shape (n,)."""
        return self.warp.forward(
            self.triangular.forward(np.asarray(np.linalg.solve(self.factor, (points - self.mean).T).T))
        )

    def points(self, scores: FloatArray) -> FloatArray:
        """Return points of scores (n, d)."""
        return np.asarray(self.mean + self.triangular.inverse(self.warp.inverse(scores)) @ self.factor.T)

    def widened(self, factor: float, dof: float) -> WarpedStudentT:
        """Return the same density with its scale multiplied."""
        return replace(self, factor=factor * self.factor, dof=dof)

    def sample(self, random: np.random.RandomState, size: int) -> FloatArray:
        """Return independent draws, shape (size, d)."""
        normal = random.randn(size, self.mean.size)
        return self.points(normal / np.sqrt(random.chisquare(self.dof, size) / self.dof)[:, None])

    def log_density(self, points: FloatArray) -> FloatArray:
        """Return the log-density at points (n, d), shape (n,)."""
        d, dof = self.mean.size, self.dof
        scores, log_slope = self.scores(points)
        constant = gammaln(0.5 * (dof + d)) - gammaln(0.5 * dof) - 0.5 * d * np.log(dof * np.pi)
        constant -= float(np.linalg.slogdet(self.factor)[1])
        return np.asarray(constant + log_slope - 0.5 * (dof + d) * np.log1p(np.sum(scores**2, axis=1) / dof))
