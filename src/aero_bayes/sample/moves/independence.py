"""Independence move: propose from a fixed heavy-tailed approximation of the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from emcee.moves import MHMove
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import gammaln

from aero_bayes.sample.moves.warp import Warp

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HeavyTail:
    """Multivariate t density of whitened coordinates, each of which may be bent by itself.

    A draw is ``mean + factor @ warp^-1(t)`` with t from the standard multivariate t of ``dof`` degrees of freedom;
    ``mean`` is (d,), the lower Cholesky ``factor`` (d, d). Whitening first keeps strong correlations exact whatever
    the warps are.
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
        """The density that resembles samples (n, d): their mean and covariance, bent where a margin is not normal."""
        plain = cls.of(samples.mean(axis=0), np.atleast_2d(np.cov(samples.T)), dof)
        white = solve_triangular(plain.factor, (samples - plain.mean).T, lower=True).T
        return cls(plain.mean, plain.factor, dof, Warp.fit(white))

    def resembles(self, samples: FloatArray) -> bool:
        """Whether samples (n, d) have about the location and the spread of this density, in every coordinate."""
        white = solve_triangular(self.factor, (samples - self.mean).T, lower=True).T
        scores = np.clip(self.warp.forward(white)[0], -10.0, 10.0)
        spread = np.std(scores, axis=0)
        return bool(np.all(np.abs(np.mean(scores, axis=0)) < 0.3) and np.all((spread > 0.75) & (spread < 1.35)))

    def widened(self, factor: float, dof: float) -> HeavyTail:
        """The same with its scale multiplied."""
        return HeavyTail(self.mean, factor * self.factor, dof, self.warp)

    def sample(self, random: np.random.RandomState, size: int) -> FloatArray:
        """Independent draws, shape (size, d)."""
        normal = random.randn(size, self.mean.size)
        scores = normal / np.sqrt(random.chisquare(self.dof, size) / self.dof)[:, None]
        return np.asarray(self.mean + self.warp.inverse(scores) @ self.factor.T)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Log-density at points (n, d), shape (n,)."""
        d, dof = self.mean.size, self.dof
        white = solve_triangular(self.factor, (points - self.mean).T, lower=True).T
        scores, log_slope = self.warp.forward(white)
        constant = gammaln(0.5 * (dof + d)) - gammaln(0.5 * dof) - 0.5 * d * np.log(dof * np.pi)
        constant -= np.sum(np.log(np.diag(self.factor)))
        return np.asarray(constant + log_slope - 0.5 * (dof + d) * np.log1p(np.sum(scores**2, axis=1) / dof))


class IndependenceMove(MHMove):  # type: ignore[misc]
    """Propose x' from a fixed density q, accept with probability min(1, p(x') q(x) / (p(x) q(x'))).

    As long as q does not change the chain keeps its target; heavy tails keep the weights p / q bounded, so that the
    chain converges geometrically wherever q covers p. Tierney (1994), Annals of Statistics 22, 1701; Mengersen and
    Tweedie (1996), Annals of Statistics 24, 101.
    """

    def __init__(self, proposal: HeavyTail) -> None:
        super().__init__(self._propose, ndim=proposal.mean.size)
        self.proposal = proposal

    def _propose(self, coords: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        new = self.proposal.sample(random, len(coords))
        return new, self.proposal.log_density(coords) - self.proposal.log_density(new)
