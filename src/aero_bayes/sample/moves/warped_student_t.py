"""A heavy-tailed approximation of a density: multivariate t over whitened coordinates that may each be bent."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from aero_bayes.sample.moves.shear import Shear
from aero_bayes.sample.moves.warp import Warp

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WarpedStudentT:
    """Multivariate t density of whitened coordinates, each of which may be bent by itself.

    A draw is ``mean + factor @ shear^-1(warp^-1(t))`` with t, the *scores*, from the standard multivariate t of ``dof``
    degrees of freedom; ``mean`` is (d,), ``factor`` (d, d). Whitening first keeps strong correlations exact whatever
    follows. The rows of ``axes`` (d, d) are the linear functions of a point that are whitened in turn (Cholesky), so
    that a corner of the density in the first of them stays a corner of one score.
    """

    mean: FloatArray
    factor: FloatArray
    dof: float
    warp: Warp
    shear: Shear
    axes: FloatArray

    @classmethod
    def of(
        cls, mean: FloatArray, covariance: FloatArray, dof: float = 8.0, axes: FloatArray | None = None
    ) -> WarpedStudentT:
        """The t density whose scale matrix is a covariance, made safely positive definite."""
        d = len(mean)
        axes = np.eye(d) if axes is None else axes
        covariance = axes @ covariance @ axes.T
        sd = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(sd, sd)
        values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
        safe = (vectors * np.maximum(values, 1e-10)) @ vectors.T
        factor = np.linalg.solve(axes, sd[:, None] * np.linalg.cholesky(safe))
        return cls(np.array(mean), factor, dof, Warp.identity(d), Shear.identity(d), axes)

    @classmethod
    def fit(
        cls, samples: FloatArray, dof: float = 8.0, *, axes: FloatArray | None = None, curved: bool = False
    ) -> WarpedStudentT:
        """The density that resembles samples (n, d): their mean and covariance, bent where a margin is not normal.

        Parameters
        ----------
        samples : ndarray
        dof : float
        axes : ndarray, shape (d, d), optional
            Linear functions to whiten, the least normal first; the coordinates by default.
        curved : bool
            Straighten curved ridges before the margins are bent.
        """
        axes = np.eye(samples.shape[1]) if axes is None else axes
        along = samples @ axes.T
        order = np.argsort(-Warp.departure((along - along.mean(axis=0)) / np.std(along, axis=0)), kind="stable")
        plain = cls.of(samples.mean(axis=0), np.atleast_2d(np.cov(samples.T)), dof, axes[order])
        scores = plain.scores(samples)[0]
        shear = Shear.fit(scores) if curved else plain.shear
        return replace(plain, shear=shear, warp=Warp.fit(shear.forward(scores)), axes=axes)

    def scores(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scores of points (n, d), and the log-determinant of the bending, shape (n,)."""
        return self.warp.forward(self.shear.forward(np.asarray(np.linalg.solve(self.factor, (points - self.mean).T).T)))

    def points(self, scores: FloatArray) -> FloatArray:
        """Points of scores (n, d)."""
        return np.asarray(self.mean + self.shear.inverse(self.warp.inverse(scores)) @ self.factor.T)

    def widened(self, factor: float, dof: float) -> WarpedStudentT:
        """The same with its scale multiplied."""
        return replace(self, factor=factor * self.factor, dof=dof)

    def sample(self, random: np.random.RandomState, size: int) -> FloatArray:
        """Independent draws, shape (size, d)."""
        normal = random.randn(size, self.mean.size)
        return self.points(normal / np.sqrt(random.chisquare(self.dof, size) / self.dof)[:, None])

    def log_density(self, points: FloatArray) -> FloatArray:
        """Log-density at points (n, d), shape (n,)."""
        d, dof = self.mean.size, self.dof
        scores, log_slope = self.scores(points)
        constant = gammaln(0.5 * (dof + d)) - gammaln(0.5 * dof) - 0.5 * d * np.log(dof * np.pi)
        constant -= float(np.linalg.slogdet(self.factor)[1])
        return np.asarray(constant + log_slope - 0.5 * (dof + d) * np.log1p(np.sum(scores**2, axis=1) / dof))
