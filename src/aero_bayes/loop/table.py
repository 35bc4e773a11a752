"""The table of a search: errors of all structures on the same left-out readings, and how they compare."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # imports its parts when they are first used

from aero_bayes.arrays import FloatArray

#: The terms of a structure, sorted; none is the first model.
Structure = tuple[str, ...]

#: A term is material if it lowers the error to this share: a quarter less is what an engineer changes a model for.
MATERIAL = 0.75
#: Share to which each witness alone (left-out training, validation) has to fall in that output.
BOTH = 0.9
#: Factor by which neither witness may rise in any output: as exact as a fit is. A term may not make an output worse.
#: From 1.005 to 1.03 it decides alike on all tables of real rigs.
WORSE = 1.02
#: Standard errors by which one structure must predict better to be clearly better; with few blocks more (Student's t).
CLEAR = 2.0
#: Resampled sets of blocks, and their seed: standard errors are known to 4 %.
DRAWS, SEED = 400, 1
#: Error, over that of the first model, of a structure that cannot be simulated.
FAILED = 1e3


@dataclass(frozen=True, eq=False)
class Row:
    """One structure: squared errors (blocks, outputs) on left-out training readings and on ``validation`` readings.

    ``free`` is its number of free parameters, ``refitted`` whether it was fitted again without each fold. ``test`` is
    the RMS on test readings by output, which no decision uses. There may be no validation."""

    terms: Structure
    errors: FloatArray
    free: int
    refitted: bool = False
    validation: FloatArray | None = None
    test: Mapping[str, float] = field(default_factory=dict)


@dataclass(eq=False)
class Table:
    """Errors of all structures, and of each term its port, the coarser law that it refines, and whether it is a curve.

    ``least`` (outputs,) is the squared error that counts as none, ``readings`` the number of training readings."""

    outputs: tuple[str, ...]
    least: FloatArray
    ports: Mapping[str, str]
    refines: Mapping[str, str]
    curves: Collection[str]
    rows: dict[Structure, Row] = field(default_factory=dict)
    readings: int | None = None

    @property
    def blocks(self) -> int:
        """Number of blocks of training readings."""
        return len(next(iter(self.rows.values())).errors)

    @cached_property
    def _draws(self) -> tuple[FloatArray, ...]:
        """How often each block is in each resampled set (draws, blocks), by witness."""
        rng, found = np.random.default_rng(SEED), []
        for squares in self._squares(()):
            drawn = rng.integers(0, len(squares), (DRAWS, len(squares)))
            found.append(np.stack([np.bincount(row, minlength=len(squares)) for row in drawn]).astype(np.float64))
        return tuple(found)

    @cached_property
    def _needed(self) -> float:
        """Standard errors that are clear."""
        freedom = self.blocks - 1
        return float(scipy.special.stdtrit(freedom, scipy.special.ndtr(CLEAR))) if freedom else math.inf

    def _squares(self, terms: Structure) -> tuple[FloatArray, ...]:
        """Squared errors (blocks, outputs) by witness."""
        row, first = self.rows[terms], self.rows[()]
        if first.validation is None:
            return (row.errors,)
        none = FAILED**2 * np.broadcast_to(first.validation.mean(axis=0), first.validation.shape)
        return row.errors, none if row.validation is None else row.validation

    def logs(self, squares: FloatArray) -> FloatArray:
        """Logarithms of root summed squares, by output."""
        return np.asarray(0.5 * np.log(np.maximum(squares, np.maximum(self.least, 1e-300))))

    def witnesses(self, terms: Structure) -> FloatArray:
        """Logarithm of the error over that of the first model, by witness (left out, validation) and output."""
        pairs = zip(self._squares(terms), self._squares(()), strict=True)
        return np.stack([self.logs(own.sum(axis=0)) - self.logs(first.sum(axis=0)) for own, first in pairs])

    def _drawn(self, terms: Structure) -> FloatArray:
        """:meth:`witnesses` of each resampled set of blocks (witnesses, draws, outputs)."""
        both = zip(self._draws, self._squares(terms), self._squares(()), strict=True)
        return np.stack([self.logs(n @ own) - self.logs(n @ first) for n, own, first in both])

    @cached_property
    def _confirmed(self) -> FloatArray:
        """Weights (witnesses, outputs): an output that was not read in validation has one witness."""
        read = np.stack([(squares.sum(axis=0) > 0.0).astype(float) for squares in self._squares(())])
        read[0] = 1.0
        return np.asarray(read / read.sum(axis=0))

    def by_output(self, terms: Structure) -> FloatArray:
        """Logarithm of the geometric mean of both witnesses' ratios to the first model, by output."""
        return np.asarray((self._confirmed * self.witnesses(terms)).sum(axis=0))

    def score(self, terms: Structure) -> float:
        """Sum of :meth:`by_output`: no output outvotes another, whatever its unit."""
        return float(self.by_output(terms).sum())

    def validated(self, terms: Structure) -> float:
        """Logarithm of the validation error over that of the first model, over all outputs; 0 without validation."""
        found = self.witnesses(terms)
        return float(found[1].sum()) if len(found) > 1 else 0.0

    def order(self, terms: Structure) -> tuple[float, int, Structure]:
        """What structures are sorted by, the best first, in whatever order they were found."""
        return self.score(terms), len(terms), terms

    def clear(self, one: Structure, other: Structure) -> bool:
        """Whether one structure predicts clearly better than another: by two standard errors, over resampled blocks."""
        drawn = self._confirmed[:, np.newaxis] * (self._drawn(other) - self._drawn(one))
        error = float(np.std(drawn.sum(axis=(0, 2))))
        return self.score(other) - self.score(one) > self._needed * error and math.isfinite(error)

    def material(self, one: Structure, other: Structure, share: float = MATERIAL) -> bool:
        """Whether one structure is clearly better, and by so much that it is worth a sentence.

        In an output the error falls to a share, and each witness falls; in none does a witness rise by 2 %."""
        change = np.where(self._confirmed > 0.0, self.witnesses(one) - self.witnesses(other), -math.inf)
        falls = self.by_output(one) - self.by_output(other) <= math.log(share)
        falls &= np.all(change <= math.log(BOTH), axis=0)
        return bool(falls.any() and np.all(change <= math.log(WORSE))) and self.clear(one, other)

    def share(self, one: Structure, other: Structure) -> tuple[float, float, str]:
        """Left-out error of one structure over that of another in the output whose error falls most by both witnesses,
        its standard error, and the output."""
        k = int(np.argmin(self.by_output(one) - self.by_output(other)))
        ratio = float(np.exp(self.witnesses(one)[0, k] - self.witnesses(other)[0, k]))
        drawn = self._drawn(one)[0, :, k] - self._drawn(other)[0, :, k]
        return ratio, float(np.std(np.exp(drawn))), self.outputs[k]

    def share_of_term(self, terms: Structure, term: str) -> tuple[float, float, str]:
        """:meth:`share` of a term beside exactly the others; where these were not fitted, beside the best of them."""
        others = tuple(t for t in terms if t != term)
        return self.share(terms, others if others in self.rows else self.without(terms, term))

    def without(self, terms: Structure, term: str) -> Structure:
        """The best structure within others without one of its terms; the coarser law may stand in its place."""
        kept = set(terms) - {term} | ({self.refines[term]} if term in self.refines else set())
        return min((k for k in self.rows if set(k) <= kept), key=self.order)

    def best_of_size(self, among: Iterable[Structure]) -> dict[int, Structure]:
        """The best structure of each number of terms."""
        best: dict[int, Structure] = {}
        for terms in sorted(among, key=self.order):
            best.setdefault(len(terms), terms)
        return best

    def swaps(self, model: Structure, term: str) -> dict[str, float]:
        """Terms that were tried in the place of one, and the logarithm of the error with each over that with it."""
        rest, score = set(model) - {term}, self.score(model)
        tried = (k for k in self.rows if len(k) == len(model) and rest < set(k) and term not in k)
        return {next(iter(set(k) - rest)): self.score(k) - score for k in sorted(tried, key=self.order)}

    def to_dict(self) -> dict[str, Any]:
        """Return what ``structures.json`` holds."""
        return {
            "outputs": list(self.outputs),
            "least": self.least.tolist(),
            "ports": dict(self.ports),
            "refines": dict(self.refines),
            "curves": sorted(self.curves),
            "readings": self.readings,
            "structures": [
                {
                    "terms": list(row.terms), "free": row.free, "refitted": row.refitted,
                    "errors": _rounded(row.errors),
                    "validation": None if row.validation is None else _rounded(row.validation),
                    "test": dict(row.test),
                }
                for row in self.rows.values()
            ],
        }  # fmt: skip

    @classmethod
    def of(cls, found: Mapping[str, Any]) -> Table:
        """Read what ``structures.json`` holds."""
        least, curves = np.array(found["least"], dtype=np.float64), frozenset(found["curves"])
        table = cls(tuple(found["outputs"]), least, found["ports"], found["refines"], curves)
        table.readings = found.get("readings")
        for row in found["structures"]:
            terms, errors = tuple(row["terms"]), np.array(row["errors"], dtype=np.float64)
            confirmed = None if row["validation"] is None else np.array(row["validation"], dtype=np.float64)
            table.rows[terms] = Row(terms, errors, row["free"], row.get("refitted", False), confirmed, row["test"])
        return table


def _rounded(squares: FloatArray) -> list[list[float]]:
    return [[float(f"{e:.5g}") for e in block] for block in squares.tolist()]


def law_of(term: str) -> str:
    """Return the law of a term ``law@port``; a declared term is its own law."""
    return term.rpartition("@")[0] or term
