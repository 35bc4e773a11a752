"""Where an additional term is inserted into the text of a balance equation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.errors import InputError
from aero_bayes.modelica.edits import TextEdit
from aero_bayes.modelica.parse import BOOLEAN, OPERATORS, evaluate_expression
from aero_bayes.modelica.syntax import (
    DIVIDES,
    Array,
    Call,
    Expression,
    If,
    Name,
    factors,
    names_in,
    short_text,
    summands,
    walk,
)
from aero_bayes.modelica.units import Dimension, dimension, has_number

Driver = Callable[[Expression], bool]
Factors = tuple[tuple[str, Expression], ...]
#: Of a vector equation: the number of a row, from one, and of how many.
RowIndex = tuple[int, int]
#: Largest number of rows of a vector that is written out.
MAX_WRITTEN_ROWS = 6


@dataclass(frozen=True)
class InsertionPoint:
    """A sum on one side of an equation, to which a term can be appended."""

    group: Expression
    sign: int
    side: int
    like: tuple[Expression, ...]
    factors: Factors = ()
    row: RowIndex | None = None
    loop: tuple[str, int] | None = None

    def insert(self, text: str, sign: int = 1) -> list[TextEdit]:
        """Return edits that append ``text`` so that it opposes a change, or drives it with ``sign`` -1."""
        (start, end), wrap = self.group.span, _binds_less(self.group)
        operator = "+" if self.sign * sign > 0 else "-"
        opening = [TextEdit(start, start, "(")] if wrap else []
        text = in_vector(text, self.row) if self.row else text
        text = f"(if {self.loop[0]} == {self.loop[1]} then {text} else 0)" if self.loop else text
        return [*opening, TextEdit(end, end, f"{')' if wrap else ''} {operator} {text}")]

    def rest(
        self, sides: tuple[Expression, Expression], driver: Driver, values: Mapping[str, float]
    ) -> list[tuple[int, Expression]]:
        """Return what drives, without the driver: the other terms of the sum, and those of the side that it equals."""
        terms = summands(self.group)
        own = [(-self.sign * s, t) for s, t in terms if sign_of_factor(t, driver, values) is None]
        if len(own) == len(terms):
            return own
        return [*((self.sign * s, t) for s, t in summands(sides[1 if self.side > 0 else 0])), *own]

    def dimension(self, of: Callable[[str], Dimension | None], sides: Sequence[Expression] = ()) -> Dimension | None:
        """Return the dimension of the terms, from the first term whose variables all have a unit.

        Names are tried before products. Terms with numbers are tried last, because a number such as 9.81 may have a
        dimension that is not written."""
        others = [] if self.factors else [t for s in sides for _, t in summands(s)]
        terms = [*self.like, *(t for t in others if not has_number(t))]
        ordered = sorted(terms, key=lambda t: (has_number(t), not isinstance(t, Name)))
        return next((d for t in ordered if (d := dimension(t, of)) is not None), None)


def in_vector(text: str, row: RowIndex) -> str:
    """Return a vector expression with a term in one row and zeros elsewhere."""
    k, of = row
    if of > MAX_WRITTEN_ROWS:
        return f"{{if row_k == {k} then {text} else 0 for row_k in 1:{of}}}"
    return f"{{{', '.join(text if i == k else '0' for i in range(1, of + 1))}}}"


def find_insertion_point(
    sides: tuple[Expression, Expression],
    driver: Driver,
    *,
    constants: frozenset[str],
    values: Mapping[str, float],
    row: RowIndex | None = None,
) -> InsertionPoint | None:
    """Find where an opposing term is inserted into an equation."""
    rows = [None if row is not None and isinstance(s, Array) else row for s in sides]
    if row is not None:
        sides = element_of_row(sides[0], row), element_of_row(sides[1], row)
    signs = [sign_of_factor(side, driver, values) for side in sides]
    if (signs[0] is None) == (signs[1] is None):
        return None
    side = 1 if signs[0] is not None else -1
    own, other = sides if side > 0 else sides[::-1]
    own_row, other_row = rows if side > 0 else rows[::-1]
    sign = signs[0] if signs[0] is not None else signs[1]
    assert sign is not None
    if len(summands(own)) > 1:
        return InsertionPoint(own, sign, side, _terms(own), (), own_row)
    inner = None
    if driver(summands(own)[0][1]):
        inner = _solved_right_side(other) if other_row else None
        inner = inner or _numerator(other, constants)
    if inner is not None:
        group, around = inner
        scale = _product_sign([t for _, t in around], values)
        return InsertionPoint(group, -sign * scale, -side, _terms(group), around, other_row)
    return InsertionPoint(other, -sign, -side, (*_terms(other), own), (), other_row)


def _binds_less(tree: Expression) -> bool:
    """Return whether an expression needs parentheses in a sum."""
    return isinstance(tree, If) or (isinstance(tree, Call) and OPERATORS.get(tree.function, tree.function) in BOOLEAN)


def element_of_row(side: Expression, row: RowIndex) -> Expression:
    """Return one element of a side that is an array constructor; any other side unchanged."""
    return side.items[row[0] - 1] if isinstance(side, Array) and len(side.items) == row[1] else side


def _solved_right_side(tree: Expression) -> tuple[Expression, Factors] | None:
    """Return ``b`` of ``solve(M, b)``, with the matrix as a factor."""
    match tree:
        case Call(function, (matrix, right)) if function.rpartition(".")[2] == "solve":
            return right, (("*", matrix),)
    return None


def _terms(tree: Expression) -> tuple[Expression, ...]:
    return tuple(t for _, t in summands(tree))


def sign_of_factor(tree: Expression, driver: Driver, values: Mapping[str, float]) -> int | None:
    """Return the sign of the coefficient of the driver; None if it does not occur, or not as a factor of a term."""
    if driver(tree):
        return 1
    terms = [(1, item) for item in tree.items] if isinstance(tree, Array) else summands(tree)
    if terms != [(1, tree)]:
        signs = ((sign, sign_of_factor(t, driver, values)) for sign, t in terms)
        return next((sign * found for sign, found in signs if found is not None), None)
    parts = factors(tree)
    for k, (operator, part) in enumerate(parts if len(parts) > 1 else ()):
        found = sign_of_factor(part, driver, values)
        if found is not None and operator not in DIVIDES:
            return found * _product_sign([p for i, (_, p) in enumerate(parts) if i != k], values)
    return None


def _product_sign(trees: Sequence[Expression], values: Mapping[str, float]) -> int:
    sign = 1
    for t in trees:
        known = {name: values.get(name, 1.0) for n in walk(t) if isinstance(n, Name) for name in [short_text(n)]}
        try:
            sign *= -1 if evaluate_expression(t, known) < 0.0 else 1
        except (InputError, ArithmeticError, ValueError, TypeError):
            continue
    return sign


def _numerator(tree: Expression, constants: frozenset[str]) -> tuple[Expression, Factors] | None:
    """Return the only factor of a product that is not constant, if it is a sum, and the constant factors."""
    parts = factors(tree)
    changing = [k for k, (_, f) in enumerate(parts) if isinstance(f, If) or not names_in(f) <= constants]
    if len(parts) == 1 or len(changing) != 1:
        return None
    operator, group = parts[changing[0]]
    if operator in DIVIDES or len(summands(group)) == 1:
        return None
    return group, tuple(part for k, part in enumerate(parts) if k != changing[0])
