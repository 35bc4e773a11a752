"""Search over families of input signals: a Latin hypercube, then random local search from the best of each family."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.swarm import latin_hypercube
from aero_bayes.progress import Progress, Watched
from aero_bayes.simulation.interface import Engine

#: Steps a staircase takes, and sines a sum has.
STEPS, SINES = 8, 10
#: How often a signal that is not made of jumps is updated, in Hz.
UPDATE_HZ = 20.0


@dataclass(frozen=True)
class SignalFamily:
    """Signals of one kind: ``signal`` maps a point (``size``,) of the unit cube and times (n,) in s to values (n,)."""

    name: str
    size: int
    signal: Callable[[FloatArray, FloatArray], FloatArray]


def _staircase_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Hold each of eight levels for a share of the time."""
    levels, shares = 2.0 * u[:STEPS] - 1.0, 0.15 + u[STEPS:]
    ends = np.cumsum(shares) / shares.sum() * (time[-1] - time[0])
    index = np.searchsorted(ends, time - time[0], side="right")
    return np.asarray(levels[np.minimum(index, STEPS - 1)])


def _binary_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Return a pseudo-random binary signal: height, offset, clock, and which one."""
    clock = _between(u[2], 0.05, 4.0)
    tick = ((time - time[0]) / clock + 1e-9).astype(np.int64)
    bits = np.random.default_rng(int(1e6 * u[3])).integers(0, 2, int(tick[-1]) + 1)
    return np.clip(_swing(u, 2.0 * bits[tick] - 1.0), -1.0, 1.0)


def _square_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Return a square wave: height, offset, period."""
    period = _between(u[2], 0.2, 20.0)
    return np.clip(_swing(u, np.where(np.mod(time - time[0], period) < 0.5 * period, 1.0, -1.0)), -1.0, 1.0)


def _release_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Return one level, then zero: the body swings freely to rest."""
    held = (0.1 + 0.8 * u[1]) * (time[-1] - time[0])
    return np.where(time - time[0] < held, 2.0 * u[0] - 1.0, 0.0)


def _multi_sine_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Sum ten sines with random phases: height, offset, lowest and highest frequency, and which phases."""
    low = _between(u[2], 0.05, 0.5)
    frequency = np.geomspace(low, low * _between(u[3], 2.0, 30.0), SINES)
    phase = np.random.default_rng(int(1e6 * u[4])).uniform(0.0, 2.0 * np.pi, SINES)
    wave = np.sin(np.outer(_updates(time), 2.0 * np.pi * frequency) + phase).sum(axis=1)
    return np.clip(_swing(u, wave / max(float(np.abs(wave).max()), 1e-9)), -1.0, 1.0)


def _chirp_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Return a sine of rising frequency: height, offset, first and last frequency."""
    low, high = _between(u[2], 0.02, 0.5), _between(u[3], 0.3, 5.0)
    t = _updates(time)
    phase = 2.0 * np.pi * (low * t + 0.5 * (high - low) * t**2 / max(float(t[-1]), 1e-9))
    return np.clip(_swing(u, np.sin(phase)), -1.0, 1.0)


def _swing(u: FloatArray, wave: FloatArray) -> FloatArray:
    return np.asarray(u[0] * wave + (2.0 * u[1] - 1.0))


def _between(u: float, low: float, high: float) -> float:
    return float(low * (high / low) ** u)


def _updates(time: FloatArray) -> FloatArray:
    """Return the time since the start, rounded down to the last update."""
    return np.asarray(np.floor((time - time[0]) * UPDATE_HZ + 1e-9) / UPDATE_HZ)


FAMILIES = (
    SignalFamily("steps", 2 * STEPS, _staircase_signal),
    SignalFamily("binary", 4, _binary_signal),
    SignalFamily("square wave", 3, _square_signal),
    SignalFamily("step and release", 2, _release_signal),
    SignalFamily("multi-sine", 5, _multi_sine_signal),
    SignalFamily("chirp", 4, _chirp_signal),
)


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

    ``engine`` is what simulates them."""

    start: int = 16
    rounds: int = 6
    candidates: int = 12
    families: int = 2
    spread: float = 0.25
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
    steps = len(FAMILIES) + settings.rounds * settings.families
    found = []
    for k, family in enumerate(FAMILIES):
        cube = latin_hypercube(settings.start, family.size, rng)
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
            if tell("candidates", (len(FAMILIES) + k * settings.rounds + turn + 1) / steps, here.family.name):
                break
    return sorted(found, key=lambda f: f.score)


def _best(score: Score, family: SignalFamily, cube: FloatArray, time: FloatArray) -> BestSignal:
    signals = [family.signal(u, time) for u in cube]
    scores = score(signals)
    best = int(np.argmin(scores))
    return BestSignal(family, cube[best], signals[best], float(scores[best]))
