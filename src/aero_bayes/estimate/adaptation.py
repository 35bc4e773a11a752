"""What a sampler learns of a density during burn-in: a proposal, and a surrogate (Gaussian process regression)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import chdtri, ndtr

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.moves import KNOT_SCORES, Warp, WarpedStudentT

Density = Callable[[FloatArray], FloatArray]

#: Burn-in ends when, in so many rounds in succession, the acceptance of the surrogate's draws was at least this, and
#: nearly every point was left after at most so many of them.
MIN_GOOD_ROUNDS, MIN_ACCEPTANCE, MAX_STAY = 2, 0.8, 6.0
#: Logarithm of the proposal's share in a surrogate density.
_LOG_PROPOSAL_SHARE = float(np.log(0.05))
#: Distances of the first points of a cut, in standard deviations; further ones follow by this ratio.
_FIRST_DISTANCES, _DISTANCE_RATIO, _MAX_FURTHER_POINTS, _MAX_DEPTH = (0.3, 0.6, 1.0, 1.6, 2.5, 4.0), 1.6, 14, 20.0


#: Length scales, amplitudes (nats squared) and relative roughnesses among which the marginal likelihood chooses.
_LENGTHS, _WARPED_LENGTHS, _AMPLITUDES = (2.0, 5.0, 12.0, 30.0), (1.0, 3.0), 10.0 ** np.arange(0, 6)
_ROUGHNESSES = (0.0, 0.1, 1.0)
#: Correlation length of the part with corners.
_ROUGH_LENGTH = 3.0
#: Standard deviation of the error at the mode, in nats; it grows with the depth below the mode.
_NOISE_AT_MODE = 0.02
#: Points that fit the length scales, and points of the surrogate.
_HYPERPARAMETER_POINTS, _MAX_POINTS = 300, 2000


@dataclass(frozen=True, eq=False)
class Kernel:
    """Covariance of a smooth function of scores that may have corners along some of them.

    A rational quadratic kernel is multiplied by one plus an exponential kernel of single scores."""

    lengths: FloatArray
    rough: FloatArray

    def __call__(self, one: FloatArray, two: FloatArray) -> FloatArray:
        """Return the correlations of scores (n, d) with (m, d), shape (n, m)."""
        a, b = one / self.lengths, two / self.lengths
        kernel = a @ -b.T
        kernel += 0.5 * np.sum(a**2, axis=1)[:, None]
        kernel += 0.5 * np.sum(b**2, axis=1) + 1.0
        np.reciprocal(np.maximum(kernel, 1.0, out=kernel), out=kernel)
        if not self.rough.any():
            return kernel
        factor = np.ones_like(kernel)
        for j in np.flatnonzero(self.rough):
            distance = np.abs(np.subtract.outer(one[:, j], two[:, j]))
            distance /= -_ROUGH_LENGTH
            factor += self.rough[j] * np.exp(distance, out=distance)
        return np.asarray(np.multiply(kernel, factor, out=kernel))


@dataclass(frozen=True, eq=False)
class Surrogate:
    """A quadratic plus a Gaussian process, over scores of a :class:`WarpedStudentT`.

    The regression is that of Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, sections 2.7, 4.2
    and 5.4; the marginal likelihood chooses the kernel."""

    coordinates: WarpedStudentT
    quadratic: FloatArray
    centres: FloatArray
    kernel: Kernel
    weights: FloatArray
    radius: float

    @staticmethod
    def least(dimension: int) -> int:
        """Return the number of points that a fit needs."""
        return 3 * (dimension + 1) * (dimension + 2) // 4 + 10

    @classmethod
    def fit(cls, coordinates: WarpedStudentT, points: FloatArray, values: FloatArray, depth: FloatArray) -> Surrogate:
        """Fit to ``values`` (n,) at ``points`` (n, d)."""
        d = points.shape[1]
        most = max(min(_MAX_POINTS, 25 * cls.least(d)), 3 * cls.least(d))
        rows = _spread(len(points), most)
        if len(points) > most:
            rows = np.concatenate(
                [np.arange(most // 2), most // 2 + _spread(len(points) - most // 2, most - most // 2)]
            )
        scores, error = coordinates.scores(points[rows])[0], _NOISE_AT_MODE * (1.0 + depth[rows])
        pairs = list(combinations_with_replacement(range(d + 1), 2))
        ahead = np.insert(scores, 0, 1.0, axis=1)
        design = np.stack([ahead[:, i] * ahead[:, j] for i, j in pairs], axis=1)
        weight = 1.0 / (1.0 + depth[rows] / 3.0)
        ridge = 1e-6 * len(rows) * np.eye(len(pairs))
        weighed = design * weight[:, None]
        level = float(np.max(values[rows]))
        found = np.linalg.solve(weighed.T @ weighed + ridge, weighed.T @ (weight * (values[rows] - level)))
        quadratic = np.zeros((d + 1, d + 1))
        quadratic[tuple(np.transpose(pairs))] = found
        rest = values[rows] - level - design @ found
        quadratic[0, 0] += level
        some = _spread(len(rows), _HYPERPARAMETER_POINTS)
        kernel, amplitude = _choose(scores[some], rest[some], error[some], coordinates.warp.warped)
        covariance = amplitude * kernel(scores, scores) + np.diag(error**2)
        weights = amplitude * cho_solve(cho_factor(covariance, lower=True), rest)
        radius = float(np.max(np.linalg.norm(scores, axis=1)))
        return cls(coordinates, quadratic, scores, kernel, weights, radius)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Predict values at points (n, d), shape (n,)."""
        scores = self.coordinates.scores(points)[0]
        ahead = np.insert(scores, 0, 1.0, axis=1)
        outside = np.maximum(np.linalg.norm(scores, axis=1) - self.radius, 0.0)
        smooth = np.einsum("ni,ij,nj->n", ahead, self.quadratic, ahead, optimize=True)
        return np.asarray(smooth + self.kernel(scores, self.centres) @ self.weights - outside**2)


def _spread(count: int, most: int) -> NDArray[np.int64]:
    """Choose at most ``most`` of ``count`` rows, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))


def _choose(scores: FloatArray, rest: FloatArray, error: FloatArray, warped: NDArray[np.bool_]) -> tuple[Kernel, float]:
    """Choose the kernel and amplitude of the largest marginal likelihood."""
    best, found = -np.inf, (Kernel(np.ones(scores.shape[1]), np.zeros(scores.shape[1])), 1.0)
    shapes = [(length, length, 0.0) for length in _LENGTHS]
    if warped.any():
        shapes = [
            (length, short, rough)
            for length in _LENGTHS
            for short in (length, *(b for b in _WARPED_LENGTHS if b < length))
            for rough in _ROUGHNESSES
        ]
    for length, short, rough in shapes:
        kernel = Kernel(np.where(warped, short, length), np.where(warped, rough, 0.0))
        values, vectors = np.linalg.eigh(kernel(scores, scores) / np.outer(error, error))
        projected = (vectors.T @ (rest / error)) ** 2
        for amplitude in _AMPLITUDES:
            spread = amplitude * np.maximum(values, 0.0) + 1.0
            evidence = -0.5 * float(np.sum(projected / spread + np.log(spread)))
            if evidence > best:
                best, found = evidence, (kernel, float(amplitude))
    return found


@dataclass(frozen=True, eq=False)
class SurrogateDensity:
    """Prior times surrogate likelihood, plus a small share of the proposal, as one log-density.

    A chain is stuck where this density is far below the target. The share of the proposal, whose tails are heavy,
    prevents that where nothing was evaluated. ``level`` is the logarithm of the integral of the first part."""

    surrogate: Surrogate
    level: float

    @classmethod
    def of(cls, surrogate: Surrogate, prior: Density, points: FloatArray) -> SurrogateDensity:
        """Estimate the integral from approximate draws of the target, (n, d)."""
        ratio = surrogate.coordinates.log_density(points) - surrogate(points) - prior(points)
        return cls(surrogate, -float(np.median(ratio) + np.log(_ratios(ratio).mean())))

    def log_density(self, points: FloatArray, prior: Density, temperature: float = 1.05) -> FloatArray:
        """Return the log-density, not normalised, shape (n,); minus infinity outside the prior's support.

        An independence sampler needs a proposal with heavier tails than its target, hence a temperature above one."""
        total = np.array(prior(points))
        inside = np.isfinite(total)
        some = points[inside]
        least = self.surrogate.coordinates.log_density(some) + self.level + _LOG_PROPOSAL_SHARE
        total[inside] = np.logaddexp(total[inside] + self.surrogate(some), least)
        return total / temperature


@dataclass(frozen=True, eq=False)
class Adaptation:
    """Proposal and surrogate that the moves use.

    ``surrogate_density`` is None until enough points are known; ``steps`` of an independence sampler on it make the end
    nearly independent of the start."""

    proposal: WarpedStudentT
    surrogate_density: SurrogateDensity | None = None
    steps: int = 20
    acceptance: float = 0.0
    good_rounds: int = 0
    frozen: bool = False

    @property
    def good(self) -> bool:
        """Return whether burn-in can end."""
        return self.good_rounds >= MIN_GOOD_ROUNDS


def log_prior_of(density: Density) -> Density:
    """Return the inexpensive part of a density: its method ``log_prior``, or zero if it has none."""
    prior: Density | None = getattr(density, "log_prior", None)
    return prior if prior is not None else lambda points: np.zeros(len(points))


def scan_axes(density: Density, proposal: WarpedStudentT) -> WarpedStudentT:
    """Evaluate the density along every axis through the centre of a proposal, and warp the proposal to these profiles.

    Each axis takes about twenty evaluations. They show margins that end at a bound, and tails that are heavier than the
    curvature at the mode suggests. The proposal is unchanged if the density is zero at its centre."""
    d = proposal.mean.size
    first = np.array([-t for t in _FIRST_DISTANCES[::-1]] + list(_FIRST_DISTANCES))
    places = np.insert((np.eye(d)[:, None, :] * first[None, :, None]).reshape(-1, d), 0, 0.0, axis=0)
    values = density(proposal.points(places))
    if not np.isfinite(values[0]):
        return proposal
    cuts = [dict(zip(first.tolist(), row.tolist(), strict=True)) for row in values[1:].reshape(d, -1)]
    for cut in cuts:
        cut[0.0] = float(values[0])
    going = [(k, side) for k in range(d) for side in (-1.0, 1.0)]
    reach = _FIRST_DISTANCES[-1]
    for _ in range(_MAX_FURTHER_POINTS):
        going = [(k, s) for k, s in going if cuts[k][s * reach] > max(cuts[k].values()) - _MAX_DEPTH]
        if not going:
            break
        reach *= _DISTANCE_RATIO
        found = density(proposal.points(np.array([s * reach * np.eye(d)[k] for k, s in going])))
        for (k, s), value in zip(going, found.tolist(), strict=True):
            cuts[k][s * reach] = value
    return replace(proposal, warp=Warp.through(np.stack([_quantiles(cut) for cut in cuts])))


def _quantiles(cut: dict[float, float]) -> FloatArray:
    """Return the quantiles of the density along a cut, at the normal probabilities of ``KNOT_SCORES``."""
    place = np.array(sorted(cut))
    level = np.array([cut[t] for t in place.tolist()])
    level = np.where(np.isfinite(level), level - level.max(), -3.0 * _MAX_DEPTH)
    fine = np.unique(np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(place.tolist())]))
    density = np.exp(np.interp(fine, place, level))
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fine))])
    return np.asarray(np.interp(ndtr(KNOT_SCORES), mass / mass[-1], fine))


def adapt(
    adaptation: Adaptation,
    prior: Density,
    *,
    fresh: tuple[FloatArray, FloatArray],
    late: tuple[FloatArray, FloatArray],
    seen: tuple[FloatArray, FloatArray],
) -> Adaptation:
    """Fit proposal and surrogate again after another round of burn-in."""
    d, dof = adaptation.proposal.mean.size, adaptation.proposal.dof
    lowest = late[1].max() - 0.5 * float(chdtri(d, 1e-7)) - 10.0
    points, values = late[0][late[1] >= lowest], late[1][late[1] >= lowest]
    if len(np.unique(points[:, 0])) <= 4 * d:
        return adaptation
    acceptance, longest_stay = 0.0, np.inf
    if adaptation.surrogate_density is not None:
        inside = fresh[1] >= lowest
        error = adaptation.surrogate_density.log_density(fresh[0][inside], prior) - fresh[1][inside]
        acceptance, longest_stay = independence_acceptance(error), steps_to_leave(error)
    fitted = [WarpedStudentT.fit(points, dof, axes=adaptation.proposal.axes, curved=curved) for curved in (False, True)]
    plain, proposal = max(
        ((independence_acceptance(one.log_density(points) - values), one) for one in fitted), key=lambda pair: pair[0]
    )
    depth = seen[1].max() - seen[1]
    near = depth < max(0.5 * float(chdtri(d, 1e-3)) + 2.0, float(np.sort(depth)[: 3 * Surrogate.least(d)][-1]))
    if near.sum() <= Surrogate.least(d):
        return Adaptation(proposal)
    where, level = seen[0][near], seen[1][near]
    if adaptation.surrogate_density is not None:  # the largest errors of the last one first
        order = np.argsort(-np.abs(adaptation.surrogate_density.log_density(where, prior) - level), kind="stable")
        where, level = where[order], level[order]
    surrogate = Surrogate.fit(proposal, where, level - prior(where), seen[1].max() - level)
    surrogate_density = SurrogateDensity.of(surrogate, prior, points)
    ratio = proposal.log_density(points) - surrogate_density.log_density(points, prior)
    steps = int(np.clip(steps_to_leave(ratio), 12, 60))
    good_rounds = adaptation.good_rounds + 1 if acceptance >= MIN_ACCEPTANCE and longest_stay <= MAX_STAY else 0
    return Adaptation(proposal, surrogate_density, steps, acceptance if acceptance > plain else 0.0, good_rounds)


def independence_acceptance(log_ratio: FloatArray) -> float:
    """Estimate the acceptance rate of an independence sampler of p that proposes from s, from log(s / p) at draws of p.

    It is the expectation of min(r, r') over pairs of draws, divided by that of r. The largest ratios are trimmed: they
    come from the tails and do not contribute."""
    ratio = np.sort(_ratios(log_ratio))
    n = ratio.size
    return float(ratio @ (2.0 * (n - np.arange(n)) - 1.0) / (n * ratio.sum()))


def steps_to_leave(log_ratio: FloatArray) -> float:
    """Estimate the number of proposals from q after which nearly every chain has moved, from log(q / s) at draws of s.

    At a point of weight w = s / q, over its mean under q, about w proposals are needed."""
    ratio = _ratios(log_ratio)
    return 1.5 * float(ratio.mean() / np.quantile(ratio, 0.003))


def _ratios(log_ratio: FloatArray) -> FloatArray:
    return np.asarray(np.exp(np.minimum(log_ratio, np.quantile(log_ratio, 0.98)) - np.median(log_ratio)))
