"""Algebraic loops: unknowns that can be eliminated symbolically are, Newton's method solves the rest (tearing)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from aero_bayes.export.expression import Builder, Node
from aero_bayes.export.linear_equations import switches


@dataclass(frozen=True)
class AlgebraicLoop:
    """``0 = residuals`` in the ``unknowns``, which stay symbols in all other expressions."""

    unknowns: tuple[Node, ...]
    residuals: tuple[Node, ...]


@dataclass(frozen=True)
class Elimination:
    """``solved`` in the order of elimination: each in terms of unknowns that are left or eliminated later."""

    solved: tuple[tuple[Node, Node], ...]
    unknowns: tuple[Node, ...]
    residuals: tuple[Node, ...]

    def back_substituted(self, b: Builder, memo: dict[Node, Node]) -> dict[Node, Node]:
        """Return the eliminated unknowns in terms of those that are left."""
        found: dict[Node, Node] = {}
        inner = dict(memo)
        for symbol, expression in reversed(self.solved):
            found[symbol] = b.substitute(expression, inner)
            inner = {**memo, **found}
        return found


def eliminate(
    b: Builder, equations: Sequence[Node], unknowns: Sequence[Node], constants: frozenset[Node]
) -> Elimination:
    """Solve equations for unknowns that they contain linearly, with a factor of ``constants`` alone.

    Equations with few unknowns go first, and factors that are numbers before others."""
    left = list(equations)
    open_ = list(unknowns)
    solved: list[tuple[Node, Node]] = []
    while open_:
        best: tuple[tuple[int, int, int], int, Node, Node] | None = None
        present = [sorted(b.symbols(e) & set(open_), key=lambda s: s.index) for e in left]
        uses = {u: sum(u in p for p in present) for u in open_}
        for k, equation in enumerate(left):
            for u in present[k]:
                slope = b.derivative(equation, u)
                if slope is b.zero or not b.symbols(slope) <= constants or switches(slope):
                    continue
                rank = (0 if slope.op == "const" else 1, (len(present[k]) - 1) * (uses[u] - 1), k)
                if best is None or rank < best[0]:
                    best = (rank, k, u, slope)
        if best is None:
            break
        _, k, u, slope = best
        value = b.neg(b.div(b.substitute(left[k], {u: b.zero}), slope))
        del left[k]
        open_.remove(u)
        solved.append((u, value))
        left = [b.substitute(e, {u: value}) if u in b.symbols(e) else e for e in left]
    return Elimination(tuple(solved), tuple(open_), tuple(left))
