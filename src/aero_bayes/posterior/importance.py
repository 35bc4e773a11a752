"""Evidence of a fitted model: Laplace's approximation, and importance sampling from it, which says if it holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.target import NoiseLayout
from aero_bayes.posterior.moves.warped_student_t import WarpedStudentT
from aero_bayes.simulation.interface import Simulator

#: Shape above which an estimate from smoothed weights is not to be trusted.
RELIABLE_BELOW = 0.7


@dataclass(frozen=True, eq=False)
class WeightedSample:
    """Weighted draws of a density.

    ``points`` (n, d); ``weights`` (n,), summing to one; ``pareto_k`` the shape of the weights' tail, reliable below
    0.7; ``log_evidence`` the logarithm of the density's integral; ``ess`` the effective number of draws."""

    points: FloatArray
    weights: FloatArray
    pareto_k: float
    log_evidence: float

    @property
    def ess(self) -> float:
        return float(1.0 / np.sum(self.weights**2))

    @property
    def reliable(self) -> bool:
        return self.pareto_k < RELIABLE_BELOW

    @property
    def mean(self) -> FloatArray:
        return np.asarray(self.weights @ self.points)

    @property
    def covariance(self) -> FloatArray:
        """Return the weighted covariance, shape (d, d)."""
        centred = self.points - self.mean
        return np.asarray((self.weights[:, None] * centred).T @ centred)

    def below(self, values: FloatArray) -> FloatArray:
        """Return the posterior probability that each coordinate lies below ``values`` (d,): shape (d,)."""
        return np.asarray(self.weights @ (self.points < values))

    def quantiles(self, levels: FloatArray) -> FloatArray:
        """Return weighted quantiles, shape (len(levels), d)."""
        out = np.empty((len(levels), self.points.shape[1]))
        for j, column in enumerate(self.points.T):
            order = np.argsort(column)
            mass = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
            out[:, j] = np.interp(levels, mass, column[order])
        return out

    def resample(self, size: int, rng: np.random.Generator) -> FloatArray:
        """Return draws of equal weight, shape (size, d), by systematic resampling."""
        position = (np.arange(size) + rng.random()) / size
        index = np.minimum(np.searchsorted(np.cumsum(self.weights), position), len(self.points) - 1)
        return np.asarray(self.points[rng.permutation(index)])


def importance_sample(
    density: Callable[[FloatArray], FloatArray], proposal: WarpedStudentT, size: int, rng: np.random.Generator
) -> WeightedSample:
    """Draw from a proposal and weigh by a density."""
    points = proposal.sample(np.random.RandomState(np.random.MT19937(int(rng.integers(2**63)))), size)
    ratio = density(points) - proposal.log_density(points)
    ratio = np.where(np.isnan(ratio), -np.inf, ratio)
    if not np.isfinite(ratio).any():
        raise ValueError("the density vanishes at every draw")
    smoothed, shape = pareto_smooth(ratio)
    return WeightedSample(
        points, np.exp(smoothed - logsumexp(smoothed)), shape, float(logsumexp(smoothed) - math.log(size))
    )


def adaptive_importance_sample(
    density: Callable[[FloatArray], FloatArray],
    proposal: WarpedStudentT,
    size: int,
    rng: np.random.Generator,
    *,
    enough: Callable[[WeightedSample], bool],
    rounds: int = 8,
) -> WeightedSample:
    """Draw in rounds, each proposal fitted to the weighted draws so far; every draw counts in the end."""
    proposals, used = [proposal], []
    points, values = np.empty((0, proposal.mean.size)), np.empty(0)
    for turn in range(rounds):
        used.append(proposals[-1])
        new = used[-1].sample(np.random.RandomState(np.random.MT19937(int(rng.integers(2**63)))), size)
        points, values = np.concatenate([points, new]), np.concatenate([values, density(new)])
        mixture = logsumexp([p.log_density(points) for p in used], axis=0) - math.log(len(used))
        ratio = np.where(np.isnan(values), -np.inf, values - mixture)
        if not np.isfinite(ratio).any():
            raise ValueError("the density vanishes at every draw")
        smoothed, shape = pareto_smooth(ratio)
        total = float(logsumexp(smoothed))
        found = WeightedSample(points, np.exp(smoothed - total), shape, total - math.log(len(points)))
        if turn > 0 and enough(found):
            break
        wide = found.ess > 3.0 * points.shape[1]
        proposals.append(WarpedStudentT.of(found.mean, found.covariance, proposal.dof) if wide else used[-1])
    return found


def pareto_smooth(log_weights: FloatArray) -> tuple[FloatArray, float]:
    """Replace the largest weights by the expected order statistics of the Pareto tail fitted to them."""
    n = log_weights.size
    size = int(min(0.2 * n, 3.0 * math.sqrt(n)))
    top = float(np.max(log_weights))
    if size < 5 or not math.isfinite(top):
        return log_weights, math.inf
    order = np.argsort(log_weights, kind="stable")
    tail, cutoff = order[-size:], float(log_weights[order[-size - 1]])
    threshold = math.exp(cutoff - top)
    excess = np.exp(log_weights[tail] - top) - threshold
    if not excess[0] >= 0.0 or excess[-1] <= 1e-12:
        return log_weights, 0.0
    shape, scale = _fit_pareto(np.maximum(excess, 1e-300))
    level = (np.arange(size) + 0.5) / size
    quantile = -scale * np.log1p(-level) if abs(shape) < 1e-12 else scale * np.expm1(-shape * np.log1p(-level)) / shape
    smoothed = log_weights.copy()
    smoothed[tail] = np.minimum(np.log(threshold + quantile), 0.0) + top
    return smoothed, shape


def _fit_pareto(excess: FloatArray) -> tuple[float, float]:
    """Estimate shape and scale of a generalised Pareto distribution from increasing excesses, shape (n,).

    A quasi-Bayesian mean over a grid of the likelihood's profile, with the shape shrunk a little towards one half."""
    n = excess.size
    grid = 30 + int(math.sqrt(n))
    quartile = excess[int(n / 4 + 0.5) - 1] if n >= 4 else excess[0]
    position = np.arange(1, grid + 1) - 0.5
    inverse = 1.0 / excess[-1] + (1.0 - np.sqrt(grid / position)) / (3.0 * max(float(quartile), 1e-300))
    inverse = np.where(inverse == 0.0, 1e-12, inverse)
    slope = np.mean(np.log1p(-inverse[:, None] * excess), axis=1)
    profile = n * (np.log(-inverse / slope) - slope - 1.0)
    weight = np.exp(profile - logsumexp(profile))
    best = float(weight @ inverse)
    shape = float(np.mean(np.log1p(-best * excess)))
    scale = -shape / best
    return (shape * n + 0.5 * 10.0) / (n + 10.0), scale


#: Pareto k of the importance weights below which no further round is made.
MAX_PARETO_K = 0.6


def laplace_evidence(fit: Fit) -> float:
    """Compute the log-evidence of a fit, noise parameters integrated out with the rest (MacKay, 2003, chapter 27)."""
    layout = NoiseLayout.of(fit.calibration.data, fit.noise)
    noise = fit.laplace.mean[fit.laplace.parameters :]
    determinant = float(np.linalg.slogdet(fit.laplace.covariance)[1])
    volume = 0.5 * (len(fit.laplace.mean) * math.log(2.0 * math.pi) + determinant)
    return fit.log_posterior + float(layout.log_prior(noise[None])[0]) + volume


def importance_posterior(
    fit: Fit, simulator: Simulator, size: int, rng: np.random.Generator, *, rounds: int = 8, dof: float = 8.0
) -> WeightedSample:
    """Sample the posterior of a fit by importance from its Laplace approximation, improved from round to round."""
    first = WarpedStudentT.of(fit.laplace.mean, fit.laplace.covariance, dof)

    def enough(found: WeightedSample) -> bool:
        return found.pareto_k < MAX_PARETO_K and found.ess > 0.2 * size

    return adaptive_importance_sample(
        fit.joint_target(simulator), first, -(-size // 2), rng, enough=enough, rounds=rounds
    )
