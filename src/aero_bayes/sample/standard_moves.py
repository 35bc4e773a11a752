"""The moves of a standard run, made from what burn-in has learnt."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Protocol

from emcee.moves import Move

from aero_bayes.sample.moves import (
    DelayedAcceptanceMove,
    DelayedAcceptanceWalkMove,
    DifferentialMove,
    IndependenceMove,
    StretchMove,
)
from aero_bayes.sample.tuning import Density, Tuned


class MakeMoves(Protocol):
    """Moves and their shares, from what tuning has learnt, for a density with the inexpensive part ``prior``."""

    def __call__(self, tuned: Tuned, prior: Density) -> Sequence[tuple[Move, float]]: ...


def standard_moves(tuned: Tuned, prior: Density) -> Sequence[tuple[Move, float]]:
    """Delayed acceptance by the surrogate; where no surrogate is good, moves that need none."""
    if tuned.surrogate_density is None or (tuned.frozen and tuned.overlap == 0.0):
        share = 0.85 if tuned.frozen else 0.3
        return [(IndependenceMove(tuned.proposal), share), (DifferentialMove(), 0.09), (StretchMove(), 0.06)]
    approximation = partial(tuned.surrogate_density.log_density, prior=prior)
    return [
        (DelayedAcceptanceMove(approximation, tuned.proposal, tuned.steps), 0.95),
        (DelayedAcceptanceWalkMove(approximation, tuned.proposal), 0.05),
    ]
