"""Where a term that opposes a change enters a balance equation, as it is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.errors import InputError
from aero_bayes.physics.edit import Edit
from aero_bayes.physics.terms import Dimension, Term, dimension, evaluate, parse_term
from aero_bayes.physics.tokens import Token, find_outside

Driver = Callable[[Term], bool]


@dataclass(frozen=True)
class Entry:
    """A sum of terms in a source, and the sign (1 or -1) with which an opposing term is appended to it.

    ``wrap`` says that the sum needs parentheses first. ``like`` are the terms that the new one stands beside.
    """

    start: int
    end: int
    sign: int
    wrap: bool
    like: tuple[Term, ...]

    def insert(self, text: str, sign: int = 1) -> list[Edit]:
        """Append ``text`` so that it opposes, or with ``sign`` -1 so that it drives."""
        operator = "+" if self.sign * sign > 0 else "-"
        opening = [Edit(self.start, self.start, "(")] if self.wrap else []
        return [*opening, Edit(self.end, self.end, f"{')' if self.wrap else ''} {operator} {text}")]

    def dimension(self, of: Callable[[str], Dimension | None]) -> Dimension | None:
        """Unit of its terms, from the first one whose names all have one."""
        return next((d for t in self.like if (d := dimension(t, of)) is not None), None)


def entry_of(
    tokens: Sequence[Token], driver: Driver, *, constants: frozenset[str] = frozenset(), values: Mapping[str, float]
) -> Entry | None:
    """Find where an opposing term enters an equation ``left = right``.

    Parameters
    ----------
    tokens : sequence of Token
        The equation without description, annotation and semicolon.
    driver : callable
        Whether a part is what the balance drives, such as ``der(v)``.
    constants : frozenset of str
        Names that do not change: ``der(v) = (u - d * v) / m`` takes the term into the parentheses.
    values : mapping
        Numbers of parameters, for the sign of a factor; positive where missing.

    Returns
    -------
    Entry or None
        None where the equation does not contain the driver, or not linearly.
    """
    at = find_outside(tokens, frozenset({"="}))
    if at in (0, len(tokens)) or at + 1 >= len(tokens):
        return None
    try:
        sides = parse_term(tokens[:at]), parse_term(tokens[at + 1 :])
    except InputError:
        return None
    signs = [_sign_of(side, driver, values) for side in sides]
    if (signs[0] is None) == (signs[1] is None):
        return None
    own, other = (sides[0], sides[1]) if signs[0] is not None else (sides[1], sides[0])
    sign = signs[0] if signs[0] is not None else signs[1]
    assert sign is not None
    if own.kind == "sum" and len(own.parts) > 1:
        return Entry(own.start, own.end, sign, False, tuple(p for _, p in own.parts))
    bare = driver(_stripped(own))
    inner = _numerator(other, constants, values) if bare else None
    if inner is not None:
        group, scale = inner
        return Entry(group.start, group.end, -sign * scale, group.kind == "opaque", _parts(group))
    if other.kind == "group" and other.parts[0][1].kind == "sum":
        group = other.parts[0][1]
        return Entry(group.start, group.end, -sign, False, _parts(group))
    return Entry(other.start, other.end, -sign, other.kind == "opaque", (*_parts(other), own))


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
    if term.kind in ("sum", "group"):
        for operator, part in term.parts:
            found = _sign_of(part, driver, values)
            if found is not None:
                return -found if operator == "-" else found
        return None
    if term.kind != "product":
        return None
    for k, (operator, part) in enumerate(term.parts):
        found = _sign_of(part, driver, values)
        if found is not None and operator != "/":
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


def _numerator(term: Term, constants: frozenset[str], values: Mapping[str, float]) -> tuple[Term, int] | None:
    """The one sum in parentheses of a product whose other factors are constant, and the sign of those."""
    negative = 1
    while term.kind == "sum" and len(term.parts) == 1:
        negative *= -1 if term.parts[0][0] == "-" else 1
        term = term.parts[0][1]
    if term.kind != "product":
        return None
    groups = [
        (k, p.parts[0][1])
        for k, (operator, p) in enumerate(term.parts)
        if operator == "*" and p.kind == "group" and not _constant(p, constants)
    ]
    others = [p for k, (_, p) in enumerate(term.parts) if not groups or k != groups[0][0]]
    if len(groups) != 1 or not all(_constant(p, constants) for p in others):
        return None
    return groups[0][1], negative * _product_sign(others, values)


def _constant(term: Term, constants: frozenset[str]) -> bool:
    return all(t.word in constants for t in term.walk() if t.kind == "name") and term.kind != "opaque"
