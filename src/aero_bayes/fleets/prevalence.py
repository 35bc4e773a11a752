"""How common an effect is in the fleet, taking account of the rigs that have it too weakly to be noticed.

A rig's loop names an effect if with it the logarithm of the error on left-out readings falls by more than a bar. Such
falls (gains) of those that have it are taken as log-normal; the rigs where it was named say of this distribution what
lies above the bar, and so how much of it lies below. With x the logarithm of the gain over the bar, share π, centre a
and width b, the likelihood of n rigs of which c name it is  ∏ π N(x_i; a, b²) · (1 - π Φ(a / b))^(n - c).  It is summed
on a grid: no chain, no seed. Priors: Jeffreys' for the share, flat for the centre, half-normal for the width.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

FloatArray = NDArray[np.float64]
#: Grid of the share; of centre and width of the logarithm of gain over bar; and the width's prior scale.
SHARE_GRID = (np.arange(200) + 0.5) / 200.0
CENTRE_GRID, WIDTH_GRID, WIDTH_PRIOR_SCALE = np.linspace(-4.0, 10.0, 57), np.geomspace(0.1, 4.0, 16), 1.0
#: What an effect that no rig names for sure counts where names are shared out.
UNNAMED_WEIGHT, EM_ROUNDS = 0.1, 30


@dataclass(frozen=True)
class NamedEffect:
    """An effect that a rig's loop named, those that its data cannot tell from it, and log(gain / bar)."""

    id: str
    alike: tuple[str, ...]
    strength: float


@dataclass(frozen=True, eq=False)
class Prevalence:
    """Posterior of how common an effect is.

    Parameters
    ----------
    density : ndarray, shape (200,)
        Posterior of the share of rigs that have it, on :data:`SHARE_GRID`; sums to one.
    noticed : float
        Probability that the loop of a rig that has it names it.
    """

    density: FloatArray
    noticed: float

    def quantiles(self, levels: FloatArray) -> FloatArray:
        """Compute quantiles of the share, shape of ``levels``."""
        return np.asarray(np.interp(levels, np.cumsum(self.density) - 0.5 * self.density, SHARE_GRID))


def estimate_prevalence(strengths: FloatArray, weights: FloatArray, rigs: int) -> Prevalence:
    """Estimate how common an effect is.

    Parameters
    ----------
    strengths : ndarray, shape (c,)
        Logarithm of gain over bar where it was named; not negative.
    weights : ndarray, shape (c,)
        How much each counts: less than one where the data cannot tell the effect from another.
    rigs : int
        Number of rigs whose loop came to a conclusion.

    Returns
    -------
    Prevalence
    """
    count = float(weights.sum())
    a, b = CENTRE_GRID[:, None], WIDTH_GRID[None, :]
    gains = np.tensordot(weights, -0.5 * ((strengths[:, None, None] - a) / b) ** 2, 1) - count * np.log(b)
    prior = np.log(b) - 0.5 * (b / WIDTH_PRIOR_SCALE) ** 2  # the grid of widths is even in their logarithm
    noticed, share = np.exp(log_ndtr(a / b)), SHARE_GRID[:, None, None]
    log = (count - 0.5) * np.log(share) - 0.5 * np.log1p(-share) + (rigs - count) * np.log1p(-share * noticed)
    log = log + gains + prior
    joint = np.exp(log - log.max())
    joint /= joint.sum()
    return Prevalence(joint.sum(axis=(1, 2)), float(np.sum(joint * noticed)))


def shared_out(rigs: Sequence[Sequence[NamedEffect]]) -> list[list[dict[str, float]]]:
    """Compute the probability of each named effect and its equivalents in each rig, by EM over the fleet.

    Returns
    -------
    list of list of dict
        One dictionary for each name of each rig; it adds up to one.
    """
    groups = [[(named.id, *(id_ for id_ in named.alike if id_ != named.id)) for named in rig] for rig in rigs]
    shares = [[dict.fromkeys(group, 1.0 / len(group)) for group in rig] for rig in groups]
    for _ in range(EM_ROUNDS):
        common: Counter[str] = Counter()
        for share in (share for rig in shares for share in rig):
            common.update(share)
        shares = [[_split(group, common) for group in rig] for rig in groups]
    return shares


def _split(group: Sequence[str], common: Counter[str]) -> dict[str, float]:
    weights = [common[id_] + UNNAMED_WEIGHT for id_ in group]
    return {id_: weight / sum(weights) for id_, weight in zip(group, weights, strict=True)}
