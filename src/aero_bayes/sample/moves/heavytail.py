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
    follows.
    """

    mean: FloatArray
    factor: FloatArray
    dof: float
    warp: Warp
    shear: Shear

    @classmethod
    def of(cls, mean: FloatArray, covariance: FloatArray, dof: float = 8.0) -> WarpedStudentT:
        """The t density whose scale matrix is a covariance, made safely positive definite."""
        sd, d = np.sqrt(np.diag(covariance)), len(mean)
        correlation = covariance / np.outer(sd, sd)
        values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
        safe = (vectors * np.maximum(values, 1e-10)) @ vectors.T
        return cls(np.array(mean), sd[:, None] * np.linalg.cholesky(safe), dof, Warp.identity(d), Shear.identity(d))

    @classmethod
    def fit(
        cls, samples: FloatArray, dof: float = 8.0, *, curved: bool = False, bent_first: bool = False
    ) -> WarpedStudentT:
        """The density that resembles samples (n, d): their mean and covariance, bent where a margin is not normal.

        Parameters
        ----------
        samples : ndarray
        dof : float
        curved : bool
            Straighten curved ridges before the margins are bent.
        bent_first : bool
            Whiten the least normal coordinates first, so that a corner of the density in one of them (a delay that
            passes a sample time) stays a corner of one score. By default they keep their order.
        """
        order = np.arange(samples.shape[1])
        if bent_first:
            standard = (samples - samples.mean(axis=0)) / np.std(samples, axis=0)
            order = np.argsort(-Warp.departure(standard), kind="stable")
        plain = cls.of(samples[:, order].mean(axis=0), np.atleast_2d(np.cov(samples[:, order].T)), dof)
        back = np.argsort(order)
        white = replace(plain, mean=plain.mean[back], factor=plain.factor[back])
        scores = white.scores(samples)[0]
        shear = Shear.fit(scores) if curved else plain.shear
        return replace(white, shear=shear, warp=Warp.fit(shear.forward(scores)))

    def scores(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scores of points (n, d), and the log-determinant of the bending, shape (n,)."""
        return self.warp.forward(self.shear.forward(np.asarray(np.linalg.solve(self.factor, (points - self.mean).T).T)))

    def points(self, scores: FloatArray) -> FloatArray:
        """Points of scores (n, d)."""
        return np.asarray(self.mean + self.shear.inverse(self.warp.inverse(scores)) @ self.factor.T)

    def resembles(self, samples: FloatArray) -> bool:
        """Whether samples (n, d) have about the location and the spread of this density, in every coordinate."""
        scores = np.clip(self.scores(samples)[0], -10.0, 10.0)
        spread = np.std(scores, axis=0)
        return bool(np.all(np.abs(np.mean(scores, axis=0)) < 0.3) and np.all((spread > 0.75) & (spread < 1.35)))

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
