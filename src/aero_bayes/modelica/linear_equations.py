"""Systems of equations: linear ones solved, unknowns eliminated from others, and which equation determines which."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from aero_bayes.errors import InputError
from aero_bayes.modelica.equation_system import EquationSystem
from aero_bayes.modelica.expression import Builder, Node, topological_order
from aero_bayes.modelica.parse import BOOLEAN


def linear_solve(
    system: EquationSystem, matrix: list[list[Node]], right: list[Node], symbols: Sequence[Node]
) -> list[Node] | None:
    """Gaussian elimination on expressions; pivots are constants where there are any, else of parameters alone.

    None where a pivot may vanish when a branch is switched, so that only numbers can tell which pivot to take."""
    b = system.builder
    n = len(right)
    parameters = {b.symbol(p.name) for p in system.parameters}
    steps = {b.symbol(v.name) for v in system.discrete_variables}
    matrix = [list(row) for row in matrix]
    right = list(right)
    rows = list(range(n))
    pivots: list[tuple[int, int]] = []

    def rank(node: Node) -> tuple[int, int]:
        if node.op == "const":
            return (0, 0 if abs(node.value) == 1.0 else 1)
        return (1 if b.symbols(node) <= parameters else 2, len(b.symbols(node)))

    columns = list(range(n))
    while columns:
        options = [(rank(matrix[i][j]), i, j) for i in rows for j in columns if matrix[i][j] is not b.zero]
        if not options:
            names = ", ".join(symbols[j].name for j in columns)
            raise InputError(f"model {system.name}: singular equations for {names}")
        fill = {(i, j): _fill(b, matrix, rows, columns, i, j) for _, i, j in options}
        _, i, j = min(options, key=lambda o: (o[0], fill[o[1], o[2]], o[1], o[2]))
        if n > 1 and (switches(matrix[i][j]) or b.symbols(matrix[i][j]) & steps):
            return None
        rows.remove(i)
        columns.remove(j)
        pivots.append((i, j))
        for k in rows:
            if matrix[k][j] is b.zero:
                continue
            factor = b.div(matrix[k][j], matrix[i][j])
            for c in columns:
                matrix[k][c] = b.sub(matrix[k][c], b.mul(factor, matrix[i][c]))
            right[k] = b.sub(right[k], b.mul(factor, right[i]))
            matrix[k][j] = b.zero
    solution: list[Node] = [b.zero] * n
    known: list[int] = []
    for i, j in reversed(pivots):
        total = right[i]
        for c in known:
            total = b.sub(total, b.mul(matrix[i][c], solution[c]))
        solution[j] = b.div(total, matrix[i][j])
        known.append(j)
    return solution


def solve_where_linear(
    system: EquationSystem, equations: Sequence[Node], symbols: Sequence[Node], memo: dict[Node, Node] | None = None
) -> list[Node] | None:
    """Return the values of symbols, where equations are linear in them; ``memo`` is put in for known symbols."""
    b = system.builder
    known: dict[Node, Node] = {} if memo is None else memo
    matrix = [[b.derivative(e, s) for s in symbols] for e in equations]
    if any(b.symbols(a) & set(symbols) for row in matrix for a in row):
        return None
    try:
        constants = [b.substitute(e, {s: b.zero for s in symbols}) for e in equations]
    except (ArithmeticError, ValueError):
        return None
    matrix = [[b.substitute(a, known) for a in row] for row in matrix]
    return linear_solve(system, matrix, [b.neg(b.substitute(c, known)) for c in constants], symbols)


def switches(node: Node) -> bool:
    """Return whether an expression has branches."""
    return any(n.op in ("select", "sign", "min", "max") or n.op in BOOLEAN for n in topological_order([node], {}))


def _fill(b: Builder, matrix: list[list[Node]], rows: list[int], columns: list[int], i: int, j: int) -> int:
    """Markowitz count: how many entries a pivot could fill."""
    in_row = sum(matrix[i][c] is not b.zero for c in columns) - 1
    in_column = sum(matrix[k][j] is not b.zero for k in rows) - 1
    return in_row * in_column


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


def match(b: Builder, equations: Sequence[Node], unknowns: Sequence[Node]) -> tuple[list[int], list[int], list[int]]:
    """Give each equation an unknown (index), by augmenting paths.

    Where one is left without: the equations of the smallest set that is one unknown short, and its unknowns."""
    index = {u: i for i, u in enumerate(unknowns)}
    incidence = [sorted(index[s] for s in b.symbols(e) if s in index) for e in equations]
    owner: list[int | None] = [None] * len(unknowns)
    for start in range(len(equations)):
        came_from: dict[int, tuple[int, int | None]] = {}
        queue: deque[tuple[int, int | None]] = deque([(start, None)])
        reached = {start}
        end = None
        while queue and end is None:
            equation, via = queue.popleft()
            for u in incidence[equation]:
                if u not in came_from:
                    came_from[u] = (equation, via)
                    holder = owner[u]
                    if holder is None:
                        end = u
                        break
                    queue.append((holder, u))
                    reached.add(holder)
        if end is None:
            return [], sorted(reached), sorted(came_from)
        step: int | None = end
        while step is not None:
            equation, via = came_from[step]
            owner[step] = equation
            step = via
    matched = [0] * len(equations)
    for u, holder in enumerate(owner):
        if holder is not None:
            matched[holder] = u
    return matched, [], []
