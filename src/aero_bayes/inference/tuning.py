"""What a sampler learns of a density before its kept chain begins: cuts through it, a proposal, a stand-in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import chi2

from aero_bayes.inference.moves import HeavyTail, Surrogate, Warp
from aero_bayes.inference.moves.warp import SCORES

FloatArray = NDArray[np.float64]
Density = Callable[[FloatArray], FloatArray]

#: Overlap with the target above which a stand-in needs no more tuning.
GOOD = 0.6
#: Distances of the first points of a cut, in standard deviations; further ones follow by this ratio.
_NEAR, _RATIO, _FURTHER, _DEEP = (0.3, 0.6, 1.0, 1.6, 2.5, 4.0), 1.6, 14, 20.0


@dataclass(frozen=True, eq=False)
class Tuned:
    """The approximations that moves may propose from.

    ``surrogate`` stands for the target less its prior (None as long as too little is known); ``steps`` is how many
    steps on it forget where they started; ``overlap`` the share of its proposals that the target would accept, judged
    on points that it was not fitted to; ``frozen`` is True for the kept chain.
    """

    proposal: HeavyTail
    surrogate: Surrogate | None = None
    steps: int = 20
    overlap: float = 0.0
    frozen: bool = False


def log_prior_of(density: Density) -> Density:
    """The part of a density that costs nothing: its method ``log_prior`` (minus infinity outside its support), or zero."""
    prior: Density | None = getattr(density, "log_prior", None)
    return prior if prior is not None else lambda points: np.zeros(len(points))


def scout(density: Density, proposal: HeavyTail) -> HeavyTail:
    """Look along every axis of a proposal through its middle, and bend it to what is there.

    A margin that ends at a bound, or goes on far beyond the curvature at the mode, is seen so at the price of about
    twenty evaluations an axis. The proposal is given back as it is if its middle has no density.
    """
    d = proposal.mean.size
    first = np.array([-t for t in _NEAR[::-1]] + list(_NEAR))
    places = np.insert((np.eye(d)[:, None, :] * first[None, :, None]).reshape(-1, d), 0, 0.0, axis=0)
    values = density(proposal.points(places))
    if not np.isfinite(values[0]):
        return proposal
    cuts = [dict(zip(first.tolist(), row.tolist(), strict=True)) for row in values[1:].reshape(d, -1)]
    for cut in cuts:
        cut[0.0] = float(values[0])
    going = [(k, side) for k in range(d) for side in (-1.0, 1.0)]
    reach = _NEAR[-1]
    for _ in range(_FURTHER):
        going = [(k, s) for k, s in going if cuts[k][s * reach] > max(cuts[k].values()) - _DEEP]
        if not going:
            break
        reach *= _RATIO
        found = density(proposal.points(np.array([s * reach * np.eye(d)[k] for k, s in going])))
        for (k, s), value in zip(going, found.tolist(), strict=True):
            cuts[k][s * reach] = value
    return replace(proposal, warp=Warp.through(np.stack([_quantiles(cut) for cut in cuts])))


def _quantiles(cut: dict[float, float]) -> FloatArray:
    """Quantiles of the density along a cut, at the normal probabilities of ``SCORES``."""
    place = np.array(sorted(cut))
    level = np.array([cut[t] for t in place.tolist()])
    level = np.where(np.isfinite(level), level - level.max(), -3.0 * _DEEP)
    fine = np.unique(np.concatenate([np.linspace(a, b, 60) for a, b in zip(place[:-1], place[1:], strict=True)]))
    density = np.exp(np.interp(fine, place, level))
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fine))])
    return np.asarray(np.interp(ndtr(SCORES), mass / mass[-1], fine))


def retuned(
    tuned: Tuned, prior: Density, visited: tuple[FloatArray, FloatArray], seen: tuple[FloatArray, FloatArray]
) -> Tuned:
    """Approximations after another round.

    Parameters
    ----------
    tuned : Tuned
        Of the round before.
    prior : callable
    visited : tuple of ndarray, (n, d) and (n,)
        Where the chains have been, and the log-density there.
    seen : tuple of ndarray, (m, d) and (m,)
        All that was evaluated so far.
    """
    d = tuned.proposal.mean.size
    floor = 0.5 * float(chi2.isf(1e-7, d)) + 10.0
    good = visited[1] >= visited[1].max() - floor
    points, values = visited[0][good], visited[1][good]
    if len(np.unique(points[:, 0])) <= 4 * d:
        return tuned
    quality = 0.0
    if tuned.surrogate is not None and tuned.proposal.resembles(points):
        quality = overlap(tuned.surrogate(points) + prior(points) - values)
    proposal = HeavyTail.fit(points, tuned.proposal.dof)
    plain = overlap(proposal.log_density(points) - values)
    seen_points, seen_values = seen
    good = seen_values >= seen_values.max() - floor
    surrogate, steps = None, tuned.steps
    if good.sum() > Surrogate.least(d):
        where, level = seen_points[good], seen_values[good]
        surrogate = Surrogate.fit(proposal, where, level - prior(where), level.max() - level)
        approximate = surrogate(points) + prior(points)
        steps = int(np.clip(6.0 / overlap(proposal.log_density(points) - approximate), 12, 200))
    return Tuned(proposal, surrogate, steps, quality if quality > plain else 0.0)


def overlap(log_ratio: FloatArray) -> float:
    """Share of independent proposals from s that a stationary chain of p accepts, from log(s / p) at draws of p.

    It is the expectation of min(r, r') over pairs of draws, over that of r.
    """
    ratio = np.sort(np.exp(log_ratio - log_ratio.max()))
    n = ratio.size
    return float(ratio @ (2.0 * (n - np.arange(n)) - 1.0) / (n * ratio.sum()))
