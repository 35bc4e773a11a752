"""A round of the search and what all rounds selected; what a discovery must gain, and the odds of a round."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.loop.prospect import Scored
from aero_bayes.loop.settings import AttributeSettings
from aero_bayes.loop.stand import Held

#: Prior odds that what is missing is something that no candidate is, and the share of a gain in log-evidence that a
#: candidate's odds are built on (the evidence of correlated residuals is surer of itself than it should be).
UNTRIED, TEMPER = 0.02, 0.5


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the search: the candidates, best first, and what was made of them.

    ``nothing`` and ``untried`` are the odds of no effect and of one that no candidate is.
    """

    number: int
    base: Held
    scores: tuple[Scored, ...]
    threshold: float
    chosen: Scored | None
    equivalent: tuple[str, ...]
    why: str
    nothing: float = 0.0
    untried: float = 0.0

    @property
    def held(self) -> Held | None:
        """The fit with what was chosen."""
        return self.chosen.held if self.chosen is not None else None


@dataclass(frozen=True)
class Doubt:
    """A value that the model holds; at ``value`` it does what an effect does, but for ``behind`` in log-evidence."""

    parameter: str
    unit: str
    held: float
    value: float
    effect: str
    behind: float


@dataclass(frozen=True, eq=False)
class Selection:
    """The effects that earned their place, in the order in which they were found, and how they were.

    ``skipped`` could not be tried: the model cannot be simulated with them. ``ended`` is where the search was when its
    time was up; empty where it came to its end. ``doubts`` are values of the model that may be what is wrong instead.
    """

    held: Held
    base: Held
    rounds: tuple[Round, ...]
    equivalent: tuple[tuple[str, ...], ...]
    skipped: tuple[str, ...] = ()
    ended: str = ""
    doubts: tuple[Doubt, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        return self.held.effects


def threshold(candidates: int, settings: AttributeSettings) -> float:
    """Least gain in log-evidence that counts as a discovery among so many candidates."""
    return math.log(max(candidates, 1)) + settings.margin


def with_odds(scores: Sequence[Scored]) -> tuple[tuple[Scored, ...], float, float]:
    """Scores with their odds, then the odds of nothing and of what was not tried; they add up to one."""
    if not scores:
        return (), 1.0 - UNTRIED, UNTRIED
    prior = math.log(0.5 / len(scores))
    logs = np.array([math.log(0.5), *(prior + TEMPER * s.gain if math.isfinite(s.gain) else -np.inf for s in scores)])
    logs -= logs.max()
    shares = np.exp(logs) / np.exp(logs).sum() * (1.0 - UNTRIED)
    return tuple(replace(s, odds=float(p)) for s, p in zip(scores, shares[1:], strict=True)), float(shares[0]), UNTRIED
