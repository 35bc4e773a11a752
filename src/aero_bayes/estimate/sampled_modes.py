"""Sample a posterior that has several modes: a chain in each, mixed by how likely it is (by importance sampling)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.finished_fit import at_optimum
from aero_bayes.estimate.levenberg_marquardt import Stop
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.log_posterior import CurvatureAdjustment, JointLogPosterior
from aero_bayes.estimate.mcmc import Chain
from aero_bayes.estimate.modes import Mode, is_another, likelihood_temperature
from aero_bayes.estimate.moves import WarpedStudentT
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import Simulator

#: Shape above which an estimate from smoothed weights is not to be trusted.
RELIABLE_BELOW = 0.7


@dataclass(frozen=True, eq=False)
class Evidence:
    """The logarithm of a density's integral, and the shape of the weights' tail: reliable below 0.7."""

    log_evidence: float
    pareto_k: float
    ess: float

    @property
    def reliable(self) -> bool:
        return self.pareto_k < RELIABLE_BELOW


def importance_sample(
    density: Callable[[FloatArray], FloatArray], proposal: WarpedStudentT, size: int, rng: np.random.Generator
) -> Evidence:
    """Draw from a proposal, and weigh the draws by a density."""
    points = proposal.sample(np.random.RandomState(np.random.MT19937(int(rng.integers(2**63)))), size)
    ratio = density(points) - proposal.log_density(points)
    ratio = np.where(np.isnan(ratio), -np.inf, ratio)
    if not np.isfinite(ratio).any():
        raise ValueError("the density vanishes at every draw")
    smoothed, shape = pareto_smooth(ratio)
    total = float(logsumexp(smoothed))
    return Evidence(total - math.log(size), shape, math.exp(2.0 * total - float(logsumexp(2.0 * smoothed))))


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


#: Draws by which the integral over a region is estimated: to a few percent, where the chain's proposal is good.
INTEGRAL_DRAWS = 1000


@dataclass(frozen=True)
class ModeDraws(Mode):
    """How many draws of a posterior are of one mode, the reported one first, and whether its chain has converged."""

    draws: int
    converged: bool


def mode_fits(fit: Fit, simulator: Simulator) -> tuple[Fit, ...]:
    """Fit at each mode, the reported one first; ``simulator`` is of its calibration's problem.

    A mode that leads back to another one under the noise of the fit is left out."""
    objective = objective_of(fit.calibration, simulator)
    parameters = objective.parameters
    settings = LocalFitSettings(floors=fit.calibration.data.floors, hold_noise=True)
    known, found = [fit.optimum], [fit]
    for mode in fit.modes:
        values = fit.values.copy()
        for name, value in mode.values.items():
            if parameters.index(name) in fit.free:
                values[parameters.index(name)] = value
        with suppress(CannotFinishError):
            start = parameters.to_search(values)
            end = local_fit(objective, start, fit.free, noise=fit.noise, settings=settings, known=known)
            if end.reason is not Stop.KNOWN_OPTIMUM and is_another(objective, known, end):
                known.append(end)
                found.append(at_optimum(fit, objective, end))
    return tuple(found)


class Region(JointLogPosterior):
    """The joint log-posterior around one mode: minus infinity at points that are nearer to another one."""

    def __init__(self, joint: JointLogPosterior, fits: Sequence[Fit], own: int) -> None:
        super().__init__(joint.target, joint.layout)
        self.own, self._nearest = own, NearestMode.of(fits)

    def log_prior(self, points: FloatArray) -> FloatArray:
        """Compute the log-prior, shape (n,), minus infinity outside the region."""
        inside = self._nearest.of_points(points[:, : len(self.target.free)]) == self.own
        return np.where(inside, super().log_prior(points), -np.inf)


@dataclass(frozen=True, eq=False)
class NearestMode:
    """Which mode a point is nearest to: centres (k, f) and precisions (k, f, f) in search coordinates."""

    centres: FloatArray
    precisions: FloatArray

    @classmethod
    def of(cls, fits: Sequence[Fit]) -> NearestMode:
        """Take centres and precisions from fits at the modes."""
        free = len(fits[0].free)
        centres = np.array([fit.laplace.mean[:free] for fit in fits])
        return cls(
            centres, np.array([np.linalg.pinv(f.laplace.covariance[:free, :free], hermitian=True) for f in fits])
        )

    def of_points(self, points: FloatArray) -> NDArray[np.intp]:
        """Index of the nearest mode of points (n, f), shape (n,)."""
        off = points[None] - self.centres[:, None]
        return np.asarray(np.argmin(np.einsum("kni,kij,knj->kn", off, self.precisions, off), axis=0))


@dataclass(frozen=True, eq=False)
class NearestAdjustment(CurvatureAdjustment):
    """The curvature adjustment of the mode that a point is nearest to."""

    parts: tuple[CurvatureAdjustment, ...]
    nearest: NearestMode

    @classmethod
    def of_fits(cls, fits: Sequence[Fit]) -> NearestAdjustment | None:
        """Return the adjustment of fits at the modes; None where noise describes their residuals."""
        parts = tuple(fit.widening for fit in fits if fit.widening is not None)
        if len(parts) < len(fits):
            return None
        return cls(parts[0].centre, parts[0].map, parts[0].prior, parts, NearestMode.of(fits))

    def __call__(self, coordinates: FloatArray) -> FloatArray:
        which = self.nearest.of_points(coordinates)
        every = np.stack([part(coordinates) for part in self.parts])
        return np.asarray(every[which, np.arange(len(coordinates))])


def mode_shares(
    fits: Sequence[Fit], regions: Sequence[Region], chains: Sequence[Chain], rng: np.random.Generator
) -> FloatArray:
    """Compute how likely each mode is, shape (k,): by importance sampling from what its chain has learnt.

    Laplace's approximation, as the fit has it, where the weights of a mode's draws are not reliable, and where readings
    count as fewer since noise does not describe the residual."""
    temperature = likelihood_temperature(fits[0].optimum)
    laplace = [fit.optimum.laplace(fit.calibration.parameters, temperature)[1] for fit in fits]
    shares = np.exp(np.array(laplace) - max(laplace))
    if all(fit.widening is None for fit in fits):
        pairs = zip(regions, chains, strict=True)
        drawn = [importance_sample(r, c.adaptation.proposal, INTEGRAL_DRAWS, rng) for r, c in pairs]
        if all(one.reliable for one in drawn):
            level = np.array([one.log_evidence for one in drawn])
            shares = np.exp(level - level.max())
    return np.asarray(shares / shares.sum())


def mixed(
    parts: Sequence[tuple[FloatArray, FloatArray]], shares: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, list[int]]:
    """Mix draws (e, n, d) and densities (e, n) of all modes in random order, each by its share; count those of each.

    ``parts`` has those of each mode."""
    size = min(points.shape[1] / share for (points, _), share in zip(parts, shares, strict=True) if share > 0.0)
    counts = [round(float(share) * min(size, max(p.shape[1] for p, _ in parts))) for share in shares]
    taken = [np.linspace(0, p.shape[1] - 1, n).astype(np.int64) for (p, _), n in zip(parts, counts, strict=True)]
    order = rng.permutation(sum(counts))
    points = np.concatenate([p[:, rows] for (p, _), rows in zip(parts, taken, strict=True)], axis=1)
    density = np.concatenate([level[:, rows] for (_, level), rows in zip(parts, taken, strict=True)], axis=1)
    return points[:, order], density[:, order], [n * points.shape[0] for n in counts]


def mode_rows(
    fits: Sequence[Fit], chains: Sequence[Chain], shares: FloatArray, counts: Sequence[int]
) -> list[ModeDraws]:
    """Return what is told of the draws of each mode."""
    return [
        ModeDraws({n: f[n].value for n in f.laplace.names[: len(f.free)]}, float(share), count, chain.converged)
        for f, chain, share, count in zip(fits, chains, shares, counts, strict=True)
    ]
