"""Search over families of input signals: a Latin hypercube, then random local search from the best of each family."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.design.information import Engine
from aero_bayes.design.signal_families import FAMILIES, SignalFamily
from aero_bayes.progress import Progress, Watched

#: Scores of input signals on the full times, smaller is better, infinite for what is not allowed.
Score = Callable[[Sequence[FloatArray]], FloatArray]


@dataclass(frozen=True, eq=False)
class BestSignal:
    """The best signal of a family: where in the unit cube, its values (n,) within plus and minus one, its score."""

    family: SignalFamily
    point: FloatArray
    values: FloatArray
    score: float


@dataclass(frozen=True)
class SearchSettings:
    """Effort: candidates a family at the start, rounds of refinement, candidates a round, how many families go on.

    ``among`` are the families that are tried, ``engine`` is what simulates them."""

    start: int = 16
    rounds: int = 6
    candidates: int = 12
    families: int = 2
    spread: float = 0.25
    among: tuple[SignalFamily, ...] = FAMILIES
    seed: int = 1
    engine: Engine = "native"


def best_signals(
    score: Score,
    time: FloatArray,
    rng: np.random.Generator,
    settings: SearchSettings,
    progress: Progress | None = None,
) -> list[BestSignal]:
    """Return the best signal of each family, best first; the best families are refined.

    A step's spread shrinks by half every other round; a family's best only ever improves. The search ends with what it
    has where ``progress`` returns True."""
    tell = Watched(progress)
    steps = len(settings.among) + settings.rounds * settings.families
    found = []
    for k, family in enumerate(settings.among):
        cube = _latin(settings.start, family.size, rng)
        found.append(_best(score, family, cube, time))
        if tell("candidates", (k + 1) / steps, family.name):
            break
    found.sort(key=lambda f: f.score)
    for k in range(min(settings.families, len(found))):
        for turn in range(settings.rounds if not tell.asked_to_end else 0):
            spread = settings.spread * 0.5 ** (turn // 2)
            here = found[k]
            moved = here.point + spread * rng.standard_normal((settings.candidates, here.family.size))
            again = _best(score, here.family, 1.0 - np.abs(1.0 - np.abs(moved) % 2.0), time)
            if again.score < here.score:
                found[k] = again
            if tell("candidates", (len(settings.among) + k * settings.rounds + turn + 1) / steps, here.family.name):
                break
    return sorted(found, key=lambda f: f.score)


def _best(score: Score, family: SignalFamily, cube: FloatArray, time: FloatArray) -> BestSignal:
    signals = [family.signal(u, time) for u in cube]
    scores = score(signals)
    best = int(np.argmin(scores))
    return BestSignal(family, cube[best], signals[best], float(scores[best]))


def _latin(count: int, size: int, rng: np.random.Generator) -> FloatArray:
    """Return a Latin hypercube, shape (count, size)."""
    cells = np.stack([rng.permutation(count) for _ in range(size)], axis=1)
    return np.asarray((cells + rng.random((count, size))) / count)
