"""Where a term that opposes a change enters a balance equation, as it is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.errors import InputError
from aero_bayes.language.edits import Edit
from aero_bayes.language.tokens import Token, find_outside
from aero_bayes.physics.terms import DIVIDES, Dimension, Term, dimension, evaluate, has_number, parse_term

Driver = Callable[[Term], bool]
#: Of a vector equation: the number of a row, from one, and of how many.
Row = tuple[int, int]
#: Rows up to which a vector with one term is written out.
WRITTEN_OUT = 6


@dataclass(frozen=True)
class Entry:
    """A sum of terms on one side of an equation, and the sign (1 or -1) with which an opposing term is appended to it.

    ``factors`` are what multiplies the sum on its side, with their operators; ``side`` is 1 on the left, -1 on the
    right. ``like`` are the terms that the new one stands beside. ``row`` is given where the sum is one of vectors,
    ``loop`` where it stands in a loop: the variable, and its value where the term is to be.
    """

    group: Term
    sign: int
    side: int
    like: tuple[Term, ...]
    factors: tuple[tuple[str, Term], ...] = ()
    row: Row | None = None
    loop: tuple[str, int] | None = None

    def insert(self, text: str, sign: int = 1) -> list[Edit]:
        """Append ``text`` so that it opposes, or with ``sign`` -1 so that it drives."""
        start, end, wrap = self.group.start, self.group.end, self.group.kind == "opaque"
        operator = "+" if self.sign * sign > 0 else "-"
        opening = [Edit(start, start, "(")] if wrap else []
        text = in_vector(text, self.row) if self.row else text
        text = f"(if {self.loop[0]} == {self.loop[1]} then {text} else 0)" if self.loop else text
        return [*opening, Edit(end, end, f"{')' if wrap else ''} {operator} {text}")]

    def dimension(self, of: Callable[[str], Dimension | None], sides: Sequence[Term] = ()) -> Dimension | None:
        """Unit of its terms, from the first one whose names all have one; a plain name before a product.

        A number may have a unit that nobody wrote, such as 9.81: terms without one come first, then those of the
        equation's sides, where nothing multiplies the sum.
        """
        others = [] if self.factors else [p for s in sides for _, p in (s.parts if s.kind == "sum" else (("", s),))]
        terms = [*self.like, *(t for t in others if not has_number(t))]
        ordered = sorted(terms, key=lambda t: (has_number(t), t.kind != "name"))
        return next((d for t in ordered if (d := dimension(t, of)) is not None), None)


def in_vector(text: str, row: Row) -> str:
    """A vector that is zero but for one row."""
    k, of = row
    if of > WRITTEN_OUT:
        return f"{{if row_k == {k} then {text} else 0 for row_k in 1:{of}}}"
    return f"{{{', '.join(text if i == k else '0' for i in range(1, of + 1))}}}"


def sides_of(tokens: Sequence[Token]) -> tuple[Term, Term] | None:
    """Both sides of an equation without description, annotation and semicolon; None where it is none."""
    at = find_outside(tokens, frozenset({"="}))
    if at in (0, len(tokens)) or at + 1 >= len(tokens):
        return None
    try:
        return parse_term(tokens[:at]), parse_term(tokens[at + 1 :])
    except InputError:
        return None


def entry_of(
    sides: tuple[Term, Term],
    driver: Driver,
    *,
    constants: frozenset[str],
    values: Mapping[str, float],
    row: Row | None = None,
) -> Entry | None:
    """Find where an opposing term enters an equation.

    Parameters
    ----------
    sides : tuple of Term
        Left and right.
    driver : callable
        Whether a part is what the balance drives, such as ``der(v)``.
    constants : frozenset of str
        Names that do not change: ``der(v) = (u - d * v) / m`` takes the term into the parentheses.
    values : mapping
        Numbers of parameters, for the sign of a factor; positive where missing.
    row : tuple of int, optional
        Of a vector equation. Where a side is written element by element, the term enters that element.

    Returns
    -------
    Entry or None
        None where the equation does not contain the driver, or not linearly.
    """
    rows = [None if row is not None and s.kind == "array" else row for s in map(_opened, sides)]
    if row is not None:
        left, right = (row_of(side, row) for side in sides)
        sides = left, right
    signs = [_sign_of(side, driver, values) for side in sides]
    if (signs[0] is None) == (signs[1] is None):
        return None
    side = 1 if signs[0] is not None else -1
    own, other = sides if side > 0 else sides[::-1]
    own_row, other_row = rows if side > 0 else rows[::-1]
    sign = signs[0] if signs[0] is not None else signs[1]
    assert sign is not None
    if own.kind == "sum" and len(own.parts) > 1:
        return Entry(own, sign, side, _parts(own), (), own_row)
    inner = None
    if driver(_stripped(own)):
        inner = _solved(other) if other_row else None
        inner = inner or _numerator(other, constants)
    if inner is not None:
        group, factors = inner
        scale = _product_sign([t for _, t in factors], values)
        return Entry(group, -sign * scale, -side, _parts(group), factors, other_row)
    if other.kind == "group":
        group = other.parts[0][1]
        return Entry(group, -sign, -side, _parts(group), (), other_row)
    return Entry(other, -sign, -side, (*_parts(other), own), (), other_row)


def _opened(term: Term) -> Term:
    while term.kind == "group":
        term = term.parts[0][1]
    return term


def row_of(side: Term, row: Row) -> Term:
    """The row of a side that is written element by element; any other side as it is."""
    whole = _opened(side)
    return whole.parts[row[0] - 1][1] if whole.kind == "array" and len(whole.parts) == row[1] else side


def _solved(term: Term) -> tuple[Term, tuple[tuple[str, Term], ...]] | None:
    """What ``solve(M, b)`` makes equal to ``M * x``, and its matrix as a factor."""
    whole = _opened(term)
    if whole.kind != "call" or whole.word.rpartition(".")[2] != "solve" or len(whole.parts) != 2:
        return None
    (_, matrix), (_, right) = whole.parts
    return right, (("*", matrix),)


def _parts(term: Term) -> tuple[Term, ...]:
    return tuple(p for _, p in term.parts) if term.kind == "sum" else (term,)


def _stripped(term: Term) -> Term:
    while (term.kind == "sum" and len(term.parts) == 1) or term.kind == "group":
        term = term.parts[0][1]
    return term


def _sign_of(term: Term, driver: Driver, values: Mapping[str, float]) -> int | None:
    """Sign of the coefficient of the driver; None where it does not occur, or not as a plain factor of a term."""
    if driver(term):
        return 1
    if term.kind in ("sum", "group", "array"):
        for operator, part in term.parts:
            found = _sign_of(part, driver, values)
            if found is not None:
                return -found if operator == "-" else found
        return None
    if term.kind != "product":
        return None
    for k, (operator, part) in enumerate(term.parts):
        found = _sign_of(part, driver, values)
        if found is not None and operator not in DIVIDES:
            others = [p for i, (_, p) in enumerate(term.parts) if i != k]
            return found * _product_sign(others, values)
    return None


def _product_sign(terms: Sequence[Term], values: Mapping[str, float]) -> int:
    sign = 1
    for t in terms:
        sign *= _value_sign(t, values)
    return sign


def _value_sign(term: Term, values: Mapping[str, float]) -> int:
    known = {t.word: values.get(t.word, 1.0) for t in term.walk() if t.kind == "name"}
    try:
        return -1 if evaluate(term, known) < 0.0 else 1
    except (InputError, ArithmeticError, ValueError):
        return 1


def _numerator(term: Term, constants: frozenset[str]) -> tuple[Term, tuple[tuple[str, Term], ...]] | None:
    """The one group in parentheses of a product whose other factors are constant, and those with their operators."""
    factors: list[tuple[str, Term]] = []
    while True:
        if term.kind == "sum" and len(term.parts) == 1:
            if term.parts[0][0] == "-":
                factors.append(("*", Term("number", term.start, term.start, "-1")))
            term = term.parts[0][1]
            continue
        if term.kind == "group" and factors:
            return term.parts[0][1], tuple(factors)
        if term.kind != "product":
            return None
        changing = [k for k, (_, p) in enumerate(term.parts) if not _constant(p, constants)]
        if len(changing) != 1 or term.parts[changing[0]][0] in DIVIDES:
            return None
        factors += [part for k, part in enumerate(term.parts) if k != changing[0]]
        term = term.parts[changing[0]][1]


def _constant(term: Term, constants: frozenset[str]) -> bool:
    return all(t.word in constants for t in term.walk() if t.kind == "name") and term.kind != "opaque"
