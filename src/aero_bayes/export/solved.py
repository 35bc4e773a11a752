"""Equations that are solved in the source, ``x = solve(A, b)``, as what they say: ``A * x = b``."""

from __future__ import annotations

from dataclasses import replace

from aero_bayes.export.flat import FlatEquation
from aero_bayes.language.syntax import Call, Expression

SOLVE = "Modelica.Math.Matrices.solve"


def unsolved(e: FlatEquation) -> FlatEquation:
    """The equation times the matrix that the library's ``solve`` inverts in it, where it stands in a sum.

    The library calls LAPACK; here the equations are solved as all others are.
    """
    matrix = _matrix(e.left) or _matrix(e.right)
    return e if matrix is None else replace(e, left=_times(matrix, e.left), right=_times(matrix, e.right))


def _inverted(tree: Expression) -> tuple[Expression, Expression] | None:
    """``A`` and ``b`` of ``solve(A, b)``."""
    if isinstance(tree, Call) and tree.function == SOLVE and len(tree.args) == 2:
        return tree.args[0], tree.args[1]
    return None


def _matrix(tree: Expression) -> Expression | None:
    found = _inverted(tree)
    if found is not None:
        return found[0]
    if isinstance(tree, Call) and tree.function in ("+", "-", "neg"):
        return next((m for a in tree.args if (m := _matrix(a)) is not None), None)
    return None


def _times(matrix: Expression, tree: Expression) -> Expression:
    found = _inverted(tree)
    if found is not None and found[0] == matrix:
        return found[1]
    if isinstance(tree, Call) and tree.function in ("+", "-", "neg"):
        return Call(tree.function, tuple(_times(matrix, a) for a in tree.args))
    return Call("*", (matrix, tree))
