"""What a sampler learns of a density during burn-in: a proposal and a surrogate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtri, ndtr

from aero_bayes.arrays import FloatArray
from aero_bayes.posterior.moves import KNOT_SCORES, Warp, WarpedStudentT
from aero_bayes.posterior.surrogate import Surrogate

Density = Callable[[FloatArray], FloatArray]

#: Burn-in ends when, in so many rounds in succession, the acceptance of the surrogate's draws was at least this, and
#: nearly every point was left after at most so many of them.
MIN_GOOD_ROUNDS, MIN_ACCEPTANCE, MAX_STAY = 2, 0.8, 6.0
#: Logarithm of the proposal's share in a surrogate density.
_LOG_PROPOSAL_SHARE = float(np.log(0.05))
#: Distances of the first points of a cut, in standard deviations; further ones follow by this ratio.
_FIRST_DISTANCES, _DISTANCE_RATIO, _MAX_FURTHER_POINTS, _MAX_DEPTH = (0.3, 0.6, 1.0, 1.6, 2.5, 4.0), 1.6, 14, 20.0


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
