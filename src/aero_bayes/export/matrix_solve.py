"""Replaces the library call ``x = solve(A, b)`` in an equation by the linear equation ``A * x = b``."""

from __future__ import annotations

from dataclasses import replace

from aero_bayes.export.flat import FlatEquation
from aero_bayes.language.syntax import Call, Expression, map_children, summands

SOLVE_FUNCTION = "Modelica.Math.Matrices.solve"


def without_solve(e: FlatEquation) -> FlatEquation:
    """Return the equation times the matrix that the library's ``solve`` inverts in it, where it stands in a sum.

    The library calls LAPACK; here the equations are solved as all others are."""
    matrix = _matrix(e.left) or _matrix(e.right)
    return e if matrix is None else replace(e, left=_times(matrix, e.left), right=_times(matrix, e.right))


def _matrix(tree: Expression) -> Expression | None:
    """``A`` of a ``solve(A, b)`` among the terms of a sum."""
    return next((m for _, t in summands(tree) for m in [_inverted(t)[0]] if m is not None), None)


def _inverted(tree: Expression) -> tuple[Expression | None, Expression]:
    """``A`` and ``b`` of ``solve(A, b)``; no matrix where a tree is no such call."""
    match tree:
        case Call(function, (matrix, right)) if function == SOLVE_FUNCTION:
            return matrix, right
    return None, tree


def _times(matrix: Expression, tree: Expression) -> Expression:
    if isinstance(tree, Call) and tree.function in ("+", "-", ".+", ".-", "neg"):
        return map_children(tree, lambda t: _times(matrix, t))
    inverted, right = _inverted(tree)
    return right if inverted == matrix else Call("*", (matrix, tree))
