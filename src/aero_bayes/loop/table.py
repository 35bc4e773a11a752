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
Terms = tuple[str, ...]

#: A term is material if it lowers the error to this share: a quarter less is what an engineer changes a model for.
MATERIAL = 0.75
#: Standard errors by which one structure must predict better to be clearly better; with few blocks more (Student's t).
CLEAR = 2.0
#: Resampled sets of blocks, and their seed: standard errors are known to 4 %.
DRAWS, SEED = 400, 1


@dataclass(frozen=True, eq=False)
class Row:
    """One structure: squared ``errors`` (blocks, outputs) on left-out readings, its number of ``free`` parameters,
    whether it was ``refitted`` without each block, and RMS errors ``unseen`` by output.

    These are None before they are known, and empty where the model cannot be simulated on unseen recordings."""

    terms: Terms
    errors: FloatArray
    free: int
    refitted: bool = False
    unseen: Mapping[str, float] | None = None


@dataclass(eq=False)
class Table:
    """Errors of all structures, and of each term its port, the coarser law that it refines, and whether it is a curve.

    ``least`` (outputs,) is the squared error that counts as none."""

    outputs: tuple[str, ...]
    least: FloatArray
    ports: Mapping[str, str]
    refines: Mapping[str, str]
    curves: Collection[str]
    rows: dict[Terms, Row] = field(default_factory=dict)

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(next(iter(self.rows.values())).errors)

    @cached_property
    def _draws(self) -> FloatArray:
        """How often each block is in each resampled set (draws, blocks)."""
        drawn = np.random.default_rng(SEED).integers(0, self.blocks, (DRAWS, self.blocks))
        return np.stack([np.bincount(row, minlength=self.blocks) for row in drawn]).astype(np.float64)

    @cached_property
    def _needed(self) -> float:
        """Standard errors that are clear."""
        freedom = self._draws.shape[1] - 1
        return float(scipy.special.stdtrit(freedom, scipy.special.ndtr(CLEAR))) if freedom else math.inf

    def logs(self, squares: FloatArray) -> FloatArray:
        """Logarithms of root summed squares, by output."""
        return np.asarray(0.5 * np.log(np.maximum(squares, np.maximum(self.least, 1e-300))))

    def by_output(self, terms: Terms) -> FloatArray:
        """Logarithm of the left-out error, by output."""
        return self.logs(self.rows[terms].errors.sum(axis=0))

    def score(self, terms: Terms) -> float:
        """Sum over outputs of the logarithm of the left-out error: no output outvotes another, whatever its unit."""
        return float(self.by_output(terms).sum())

    def order(self, terms: Terms) -> tuple[float, int, Terms]:
        """What structures are sorted by, the best first, in whatever order they were found."""
        return self.score(terms), len(terms), terms

    def clear(self, one: Terms, other: Terms) -> bool:
        """Whether one structure predicts clearly better than another: by two standard errors, over resampled blocks."""
        first, second = (self.logs(self._draws @ self.rows[k].errors).sum(axis=-1) for k in (one, other))
        error = float(np.std(second - first))
        return self.score(other) - self.score(one) > self._needed * error and math.isfinite(error)

    def material(self, one: Terms, other: Terms, share: float = MATERIAL) -> bool:
        """Whether one structure is better by so much that it is worth a sentence, and clearly."""
        return self.share(one, other)[0] <= share and self.clear(one, other)

    def share(self, one: Terms, other: Terms) -> tuple[float, float, str]:
        """Error of one structure over that of another in the output where it falls most, its standard error, which."""
        ratios = self.by_output(one) - self.by_output(other)
        k = int(np.argmin(ratios))
        first, second = (self.logs(self._draws @ self.rows[s].errors)[:, k] for s in (one, other))
        return float(np.exp(ratios[k])), float(np.std(np.exp(first - second))), self.outputs[k]

    def without(self, terms: Terms, term: str) -> Terms:
        """The best structure within others without one of its terms; the coarser law may stand in its place."""
        kept = set(terms) - {term} | ({self.refines[term]} if term in self.refines else set())
        return min((k for k in self.rows if set(k) <= kept), key=self.order)

    def best_of_size(self, among: Iterable[Terms]) -> dict[int, Terms]:
        """The best structure of each number of terms."""
        best: dict[int, Terms] = {}
        for terms in sorted(among, key=self.order):
            best.setdefault(len(terms), terms)
        return best

    def swaps(self, model: Terms, term: str) -> dict[str, float]:
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
            "structures": [
                {
                    "terms": list(row.terms), "free": row.free, "refitted": row.refitted,
                    "errors": [[float(f"{e:.5g}") for e in block] for block in row.errors.tolist()],
                    "unseen": None if row.unseen is None else dict(row.unseen),
                }
                for row in self.rows.values()
            ],
        }  # fmt: skip

    @classmethod
    def of(cls, found: Mapping[str, Any]) -> Table:
        """Read what ``structures.json`` holds; of equal terms the better structure counts."""
        least, curves = np.array(found["least"], dtype=np.float64), frozenset(found["curves"])
        table = cls(tuple(found["outputs"]), least, found["ports"], found["refines"], curves)
        for row in found["structures"]:
            terms, errors = tuple(row["terms"]), np.array(row["errors"], dtype=np.float64)
            if terms not in table.rows or table.logs(errors.sum(axis=0)).sum() < table.score(terms):
                table.rows[terms] = Row(terms, errors, row["free"], row.get("refitted", False), row.get("unseen"))
        return table


def law_of(term: str) -> str:
    """Return the law of a term ``law@port``; a declared term is its own law."""
    return term.rpartition("@")[0] or term
