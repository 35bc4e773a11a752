"""Structures compared by their errors on readings that were left out, output by output."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy  # imports its parts when they are first used

from aero_bayes.arrays import FloatArray
from aero_bayes.search.structure import Structure

#: Standard errors by which one structure must predict better than another to count as clearly better.
MIN_STANDARD_ERRORS = 2.0
#: Blocks below which nothing is clear: the spread of fewer is not known.
MIN_BLOCKS = 5
#: Difference of two scores that counts as none: a ten-thousandth of the squared error, about what fits converge to. Of
#: laws that do the same at two places one would else be ahead by many standard errors, which are as small.
MIN_DIFFERENCE = 1e-4
#: Draws of as many blocks as there are, with replacement, and their seed: standard errors are known to 4 %.
DRAWS, SEED = 400, 1


@dataclass(frozen=True)
class Share:
    """Error on left-out readings with something over that without it, in the output where it falls most."""

    value: float
    sd: float
    output: str

    @property
    def fall(self) -> str:
        """How far the error falls, in words."""
        if self.value > 1.0:
            return f"rises by {100.0 * (self.value - 1.0):.0f} % (+- {100.0 * self.sd:.0f})"
        return f"falls by {100.0 * (1.0 - self.value):.0f} % (+- {100.0 * self.sd:.0f})"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Errors of structures on the same left-out readings.

    The score of a structure is the sum over outputs of the logarithm of its squared error, so that no output outvotes
    another. Standard errors are of differences, over resampled blocks."""

    squares: Mapping[Structure, FloatArray]
    outputs: tuple[str, ...]
    least: FloatArray

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(next(iter(self.squares.values())))

    @cached_property
    def _draws(self) -> FloatArray:
        """How often each block is in each resampled set (draws, blocks)."""
        count = self.blocks
        drawn = np.random.default_rng(SEED).integers(0, count, (DRAWS, count))
        return np.stack([np.bincount(row, minlength=count) for row in drawn]).astype(np.float64)

    @cached_property
    def _needed(self) -> float:
        """Standard errors that count as clear: with few blocks more of them (Student's t)."""
        blocks = self._draws.shape[1]
        if blocks < 2:
            return math.inf
        return float(scipy.special.stdtrit(blocks - 1, scipy.special.ndtr(MIN_STANDARD_ERRORS)))

    @cached_property
    def scores(self) -> dict[Structure, float]:
        """Of each structure; lower is better."""
        return {s: float(self._logs(e.sum(axis=0)).sum()) for s, e in self.squares.items()}

    @cached_property
    def ranked(self) -> list[Structure]:
        """All structures, the one with the least score first."""
        return sorted(self.squares, key=lambda s: (self.scores[s], len(s), s.terms))

    @cached_property
    def _resampled(self) -> dict[Structure, FloatArray]:
        """Scores (draws,) of each structure."""
        return {s: self._logs(self._draws @ e).sum(axis=-1) for s, e in self.squares.items()}

    def _logs(self, squares: FloatArray) -> FloatArray:
        return np.asarray(np.log(np.maximum(squares, np.maximum(self.least, 1e-300))))

    def ahead(self, one: Structure, other: Structure) -> float:
        """Return by how many standard errors one structure predicts better than another."""
        difference = self.scores[other] - self.scores[one]
        if not math.isfinite(difference):
            return math.inf if self.scores[one] < self.scores[other] else 0.0
        if abs(difference) < MIN_DIFFERENCE:
            return 0.0
        error = float(np.std(self._resampled[other] - self._resampled[one]))
        return difference / error if error > 0.0 else 0.0

    def likely_better(self, one: Structure, other: Structure) -> bool:
        """Tell whether a structure predicts left-out readings better than another by half of what makes it clear."""
        return self.blocks >= MIN_BLOCKS and self.ahead(one, other) > 0.5 * self._needed

    def clearly_better(self, one: Structure, other: Structure) -> bool:
        """Return whether one structure predicts left-out readings better than another by two standard errors."""
        return self.blocks >= MIN_BLOCKS and self.ahead(one, other) > self._needed

    def better(self, one: Structure, other: Structure, min_share: float) -> bool:
        """Return whether one structure predicts better, clearly or by so much that one standard error is enough.

        The error of an output is then at most ``min_share`` of what it is with the other: by chance such a fall is
        rare, unless it rests on few blocks."""
        much = self.much_better(one, other, min_share)
        return self.likely_better(one, other) if much else self.clearly_better(one, other)

    def far_better(self, one: Structure, other: Structure, min_share: float) -> bool:
        """Return whether one structure predicts clearly better than another, and much better."""
        return self.clearly_better(one, other) and self.much_better(one, other, min_share)

    def much_better(self, one: Structure, other: Structure, min_share: float) -> bool:
        """Tell whether with one structure the error of an output is at most ``min_share`` of that with another."""
        return float(np.exp(self._log_ratios(one, other).min())) <= min_share

    def surely_much_better(self, one: Structure, other: Structure, min_share: float) -> bool:
        """Tell whether it is so by one standard error."""
        share = self.share(one, other)
        return share.value + share.sd <= min_share

    def _log_ratios(self, one: Structure, other: Structure) -> FloatArray:
        """Return the logarithm of the error with one structure over that with another, by output (m,)."""
        first, second = (self._logs(self.squares[s].sum(axis=0)) for s in (one, other))
        return np.asarray(0.5 * (first - second))

    def simplest(self, among: Sequence[Structure], min_share: float) -> Structure:
        """Return the structure with the fewest terms of those that the best one does not beat.

        This is the rule of one standard error (Breiman, Friedman, Olshen and Stone, 1984, Classification and
        Regression Trees, 3.4.3)."""
        best = self.best(among)
        near = [s for s in among if s == best or not self.better(best, s, min_share)]
        return min(near, key=lambda s: (len(s), len(s.freed), self.scores[s], s.terms))

    def best(self, among: Iterable[Structure]) -> Structure:
        """Return the one with the least score; of equal ones the one with fewer terms."""
        return min(among, key=lambda s: (self.scores[s], len(s), s.terms))

    def share(self, one: Structure, other: Structure) -> Share:
        """Error with one structure over that with another, in the output where it falls most."""
        logs = self._log_ratios(one, other)
        k = int(np.argmin(logs))
        drawn = 0.5 * (
            self._logs(self._draws @ self.squares[one])[:, k] - self._logs(self._draws @ self.squares[other])[:, k]
        )
        return Share(float(np.exp(logs[k])), float(np.std(np.exp(drawn))), self.outputs[k])

    def wins(self, among: Sequence[Structure]) -> dict[Structure, float]:
        """Share of the resampled blocks in which each structure is the best of some."""
        first = np.argmin(np.stack([self._resampled[s] for s in among]), axis=0)
        return {s: float(np.mean(first == k)) for k, s in enumerate(among)}
