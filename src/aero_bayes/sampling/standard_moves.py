"""The moves of a standard run, made from what burn-in has learnt."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Protocol

from emcee.moves import Move

from aero_bayes.sampling.adaptation import Adaptation, Density
from aero_bayes.sampling.moves import (
    DelayedAcceptanceMove,
    DelayedAcceptanceWalkMove,
    DifferentialMove,
    IndependenceMove,
    StretchMove,
)


class MakeMoves(Protocol):
    """Moves and their shares, from what burn-in has learnt, for a density with the inexpensive part ``prior``."""

    def __call__(self, adaptation: Adaptation, prior: Density) -> Sequence[tuple[Move, float]]: ...


def standard_moves(adaptation: Adaptation, prior: Density) -> Sequence[tuple[Move, float]]:
    """Choose delayed acceptance by the surrogate; moves that need none until there is one, and where it is no good."""
    if adaptation.surrogate_density is None or (adaptation.frozen and adaptation.acceptance == 0.0):
        share = 0.85 if adaptation.frozen else 0.3
        return [(IndependenceMove(adaptation.proposal), share), (DifferentialMove(), 0.09), (StretchMove(), 0.06)]
    approximation = partial(adaptation.surrogate_density.log_density, prior=prior)
    moves: list[tuple[Move, float]] = [
        (DelayedAcceptanceMove(approximation, adaptation.proposal, adaptation.steps), 0.95),
        (DelayedAcceptanceWalkMove(approximation, adaptation.proposal), 0.05),
    ]
    # During burn-in walkers also find places where the surrogate is far too low.
    return moves if adaptation.frozen else [*moves, (DifferentialMove(), 0.5)]
