"""Linear equations between expressions, solved by Gaussian elimination."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.errors import InputError
from aero_bayes.export.equation_system import EquationSystem
from aero_bayes.export.expression import Builder, Node, topological_order
from aero_bayes.language.values import BOOLEAN


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


def switches(node: Node) -> bool:
    """Return whether an expression has branches."""
    return any(n.op in ("select", "sign", "min", "max") or n.op in BOOLEAN for n in topological_order([node], {}))


def _fill(b: Builder, matrix: list[list[Node]], rows: list[int], columns: list[int], i: int, j: int) -> int:
    """Markowitz count: how many entries a pivot could fill."""
    in_row = sum(matrix[i][c] is not b.zero for c in columns) - 1
    in_column = sum(matrix[k][j] is not b.zero for k in rows) - 1
    return in_row * in_column
