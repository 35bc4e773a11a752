"""A heavy-tailed approximation of a density: multivariate t over whitened coordinates that may each be bent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from aero_bayes.inference.moves.warp import Warp

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HeavyTail:
    """Multivariate t density of whitened coordinates, each of which may be bent by itself.

    A draw is ``mean + factor @ warp^-1(t)`` with t, the *scores*, from the standard multivariate t of ``dof`` degrees
    of freedom; ``mean`` is (d,), ``factor`` (d, d). Whitening first keeps strong correlations exact whatever the warps
    are.
    """

    mean: FloatArray
    factor: FloatArray
    dof: float
    warp: Warp

    @classmethod
    def of(cls, mean: FloatArray, covariance: FloatArray, dof: float = 8.0) -> HeavyTail:
        """The t density whose scale matrix is a covariance, made safely positive definite."""
        sd = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(sd, sd)
        values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
        safe = (vectors * np.maximum(values, 1e-10)) @ vectors.T
        return cls(np.array(mean), sd[:, None] * np.linalg.cholesky(safe), dof, Warp.identity(len(mean)))

    @classmethod
    def fit(cls, samples: FloatArray, dof: float = 8.0) -> HeavyTail:
        """The density that resembles samples (n, d): their mean and covariance, bent where a margin is not normal.

        The least normal coordinates are whitened first, so that a corner of the density in one of them (a delay that
        passes a sample time) stays a corner of one score.
        """
        standard = (samples - samples.mean(axis=0)) / np.std(samples, axis=0)
        order = np.argsort(-Warp.departure(standard), kind="stable")
        plain = cls.of(samples[:, order].mean(axis=0), np.atleast_2d(np.cov(samples[:, order].T)), dof)
        white = plain.scores(samples[:, order])[0]
        back = np.argsort(order)
        return cls(plain.mean[back], plain.factor[back], dof, Warp.fit(white))

    def scores(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scores of points (n, d), and the log-determinant of the bending, shape (n,)."""
        return self.warp.forward(np.linalg.solve(self.factor, (points - self.mean).T).T)

    def points(self, scores: FloatArray) -> FloatArray:
        """Points of scores (n, d)."""
        return np.asarray(self.mean + self.warp.inverse(scores) @ self.factor.T)

    def resembles(self, samples: FloatArray) -> bool:
        """Whether samples (n, d) have about the location and the spread of this density, in every coordinate."""
        scores = np.clip(self.scores(samples)[0], -10.0, 10.0)
        spread = np.std(scores, axis=0)
        return bool(np.all(np.abs(np.mean(scores, axis=0)) < 0.3) and np.all((spread > 0.75) & (spread < 1.35)))

    def widened(self, factor: float, dof: float) -> HeavyTail:
        """The same with its scale multiplied."""
        return HeavyTail(self.mean, factor * self.factor, dof, self.warp)

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
