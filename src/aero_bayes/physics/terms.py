"""Expressions of the source as sums and products that know where they stand; their values and units."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.errors import InputError
from aero_bayes.language.tokens import Token, find_outside, skip_group, split_outside
from aero_bayes.language.units import base_units

_LOOSE = frozenset({"and", "or", "not", "<", ">", "<=", ">=", "==", "<>", ":", "for"})
_PLUS = frozenset({"+", "-", ".+", ".-"})
_TIMES = frozenset({"*", "/", ".*", "./"})
#: Operators that divide, as numbers or element by element.
DIVIDES = frozenset({"/", "./"})
_FUNCTIONS: dict[str, Callable[..., float]] = {
    "sqrt": math.sqrt, "exp": math.exp, "log": math.log, "abs": abs, "min": min, "max": max,
    "sin": math.sin, "cos": math.cos, "tan": math.tan, "tanh": math.tanh, "atan": math.atan,
}  # fmt: skip
#: Functions whose value has the dimension of their argument.
_SAME = frozenset({"abs", "min", "max", "noEvent", "smooth", "homotopy", "diagonal", "transpose", "vector", "sum"})
_NAMED = (
    "N", "N.m", "V", "A", "W", "Pa", "Ohm", "C", "m3/s", "kg/s", "N.s/m", "N/m", "H", "F",
)  # fmt: skip
#: Temperatures that are counted from elsewhere: their differences are in K, or in shares of it.
_DEGREES = re.compile(r"\b(degC|degF|Cel)(?![A-Za-z])")

Dimension = Mapping[str, float]


@dataclass(frozen=True)
class Term:
    """A part of an expression.

    ``kind`` is sum, product, power, group (in parentheses), array (in braces), call, name, number or opaque. ``parts``
    of a sum carry their sign, of a product their operator.
    """

    kind: str
    start: int
    end: int
    word: str = ""
    parts: tuple[tuple[str, Term], ...] = ()

    def walk(self) -> Iterator[Term]:
        yield self
        for _, part in self.parts:
            yield from part.walk()


def parse_term(tokens: Sequence[Token]) -> Term:
    """The tree of an expression; what is no arithmetic (branches, comparisons, ranges) is one opaque part."""
    tokens = tuple(tokens)
    if not tokens:
        raise InputError("an expression is missing")
    if tokens[0].word == "if" or find_outside(tokens, _LOOSE) < len(tokens):
        inner = tuple(("", Term("name", t.start, t.end, t.word)) for t in tokens if t.kind == "name")
        return Term("opaque", tokens[0].start, tokens[-1].end, "", inner)
    return _sum(tokens)


def _cut(tokens: Sequence[Token], words: frozenset[str]) -> list[tuple[str, Sequence[Token]]]:
    """Parts with the operator before each; an operator directly after another one is a sign and stays."""
    parts: list[tuple[str, Sequence[Token]]] = []
    operator, begin, at = "", 0, 0
    while at < len(tokens):
        if tokens[at].kind == "sign" and tokens[at].word in words and (at > begin or (at == 0 and words is _PLUS)):
            if at > begin:
                parts.append((operator, tokens[begin:at]))
            operator, begin = tokens[at].word, at + 1
            at += 1
        elif tokens[at].kind == "sign" and tokens[at].word in "([{":
            at = skip_group(tokens, at)
        else:
            at += 1
            if at < len(tokens) and tokens[at - 1].word in ("^", ".^", "*", "/", ".*", "./"):
                at = skip_group(tokens, at) if tokens[at].word in "([{" else at + 1
    if begin >= len(tokens):
        raise InputError("an expression ends in an operator")
    parts.append((operator, tokens[begin:]))
    return parts


def _sum(tokens: Sequence[Token]) -> Term:
    parts = _cut(tokens, _PLUS)
    if len(parts) == 1 and not parts[0][0]:
        return _product(tokens)
    return Term("sum", tokens[0].start, tokens[-1].end, "", tuple(((o or "+")[-1], _product(p)) for o, p in parts))


def _product(tokens: Sequence[Token]) -> Term:
    parts = _cut(tokens, _TIMES)
    if len(parts) == 1:
        return _power(tokens)
    return Term("product", tokens[0].start, tokens[-1].end, "", tuple((o or "*", _power(p)) for o, p in parts))


def _power(tokens: Sequence[Token]) -> Term:
    if tokens[0].kind == "sign" and tokens[0].word in _PLUS:
        return Term("sum", tokens[0].start, tokens[-1].end, "", ((tokens[0].word[-1], _power(tokens[1:])),))
    at = find_outside(tokens, frozenset({"^", ".^"}))
    if at < len(tokens):
        parts = (("", _atom(tokens[:at])), ("^", _power(tokens[at + 1 :])))
        return Term("power", tokens[0].start, tokens[-1].end, "", parts)
    return _atom(tokens)


def _atom(tokens: Sequence[Token]) -> Term:
    start, end = tokens[0].start, tokens[-1].end
    if len(tokens) == 1 and tokens[0].kind == "number":
        return Term("number", start, end, tokens[0].word)
    if tokens[0].word == "(" and skip_group(tokens, 0) == len(tokens):
        if find_outside(tokens[1:-1], frozenset({","})) < len(tokens) - 2:
            return Term("opaque", start, end)
        return Term("group", start, end, "", (("", parse_term(tokens[1:-1])),))
    if tokens[0].word == "{" and skip_group(tokens, 0) == len(tokens):
        items = split_outside(tokens[1:-1])
        if any(t.word == "for" for t in tokens) or not all(items):
            return Term("opaque", start, end)
        return Term("array", start, end, "", tuple(("", parse_term(i)) for i in items))
    if tokens[0].kind == "name" or tokens[0].word == ".":
        at = 1
        while at < len(tokens) and tokens[at].word != "(":
            at = skip_group(tokens, at) if tokens[at].word == "[" else at + 1
        word = "".join(t.word for t in tokens[:at])
        if at == len(tokens):
            return Term("name", start, end, word)
        if skip_group(tokens, at) == len(tokens):
            arguments = tuple(("", parse_term(p)) for p in split_outside(tokens[at + 1 : -1]) if p)
            return Term("call", start, end, word, arguments)
    return Term("opaque", start, end)


def evaluate(term: Term, values: Mapping[str, float]) -> float:
    """The number of an expression. Raises InputError for a name without a value."""
    match term.kind:
        case "number":
            return float(term.word)
        case "name":
            if term.word not in values:
                raise InputError(f"{term.word!r} has no value here")
            return values[term.word]
        case "group":
            return evaluate(term.parts[0][1], values)
        case "sum":
            return sum(evaluate(p, values) * (-1.0 if sign == "-" else 1.0) for sign, p in term.parts)
        case "product":
            result = 1.0
            for operator, part in term.parts:
                result = result / evaluate(part, values) if operator in DIVIDES else result * evaluate(part, values)
            return result
        case "power":
            return float(evaluate(term.parts[0][1], values) ** evaluate(term.parts[1][1], values))
        case "call" if term.word in _FUNCTIONS:
            return float(_FUNCTIONS[term.word](*(evaluate(p, values) for _, p in term.parts)))
    raise InputError("an expression that is not a plain formula in sizes")


def dimension(term: Term, of: Callable[[str], Dimension | None]) -> Dimension | None:
    """Exponents of the base units, or None where they are not known. A number alone says nothing."""
    match term.kind:
        case "name":
            return of(term.word)
        case "group":
            return dimension(term.parts[0][1], of)
        case "sum":
            known = next((d for _, p in term.parts if (d := dimension(p, of)) is not None), None)
            return {} if known is None and any(p.kind == "number" for _, p in term.parts) else known
        case "product":
            total: dict[str, float] = {}
            for operator, part in term.parts:
                if part.kind == "number":
                    continue
                own = dimension(part, of)
                if own is None:
                    return None
                for base, exponent in own.items():
                    total[base] = total.get(base, 0.0) + (-exponent if operator in DIVIDES else exponent)
            return _clean(total)
        case "power" if term.parts[1][1].kind == "number":
            own = dimension(term.parts[0][1], of)
            by = float(term.parts[1][1].word)
            return None if own is None else _clean({k: v * by for k, v in own.items()})
        case "call" if term.word == "sqrt":
            own = dimension(term.parts[0][1], of)
            return None if own is None else _clean({k: v / 2 for k, v in own.items()})
        case "call" if term.word == "der" and term.parts:
            own = dimension(term.parts[0][1], of)
            return None if own is None else _clean({**own, "s": own.get("s", 0.0) - 1.0})
        case "call" if term.word == "cross" and len(term.parts) == 2:
            return dimension(Term("product", 0, 0, "", tuple(("*", p) for _, p in term.parts)), of)
        case "call" if term.word in _SAME and term.parts:
            return dimension(term.parts[-1][1], of)
        case "call":
            return {}
    return None


def has_number(term: Term) -> bool:
    """Whether a number is a factor in a term; what is added to one is a number itself."""
    if term.kind == "group":
        return has_number(term.parts[0][1])
    return term.kind == "product" and any(p.kind == "number" or has_number(p) for _, p in term.parts)


def _clean(total: Mapping[str, float]) -> Dimension:
    return {k: v for k, v in total.items() if abs(v) > 1e-9}


def dimension_of_unit(unit: str) -> Dimension | None:
    """Exponents of the base units of a unit expression; None where it is empty or not understood.

    A temperature in degC is one.
    """
    known = base_units(_DEGREES.sub("K", unit)) if unit else None
    return None if known is None else {k: float(v) for k, v in known[1].items()}


def without_angle(dim: Dimension) -> Dimension:
    """Torques are given in N.m as often as in N.m/rad: a radian is a number."""
    return {k: v for k, v in dim.items() if k != "rad"}


def unit_factors(unit: str) -> Dimension | None:
    """Exponents of the unit's own symbols, ``N.s/m`` as N, s and 1/m; None where it is empty or not understood."""
    if base_units(unit) is None if unit else True:
        return None
    total: dict[str, float] = {}
    for place, part in enumerate(unit.split("/")):
        for symbol, power in re.findall(r"([A-Za-z]+)([+-]?\d+)?", part):
            total[symbol] = total.get(symbol, 0.0) + float(power or 1) * (1 if place == 0 else -1)
    return _clean(total)


def coherent(factors: Dimension | None) -> Dimension | None:
    """Symbols whose scales cancel, in base units: ``kg.l/(s.m3.g)`` is ``1/s``. Others stay."""
    known = {symbol: base_units(symbol) for symbol in factors or {}}
    scales = {symbol: found[0] for symbol, found in known.items() if found is not None}
    if factors is None or len(scales) < len(known) or all(scale == 1.0 for scale in scales.values()):
        return factors
    if not math.isclose(math.prod(scale ** factors[symbol] for symbol, scale in scales.items()), 1.0):
        return factors
    total: dict[str, float] = {}
    for symbol, found in known.items():
        for base, power in found[1].items() if found is not None else ():
            total[base] = total.get(base, 0.0) + power * factors[symbol]
    return _clean(total)


def unit_text(factors: Dimension | None) -> str:
    """A unit expression of such exponents; empty where they are unknown or not whole."""
    if factors is None or any(abs(v - round(v)) > 1e-9 for v in factors.values()):
        return ""
    for suffix in ("", "/s", "/s2"):
        for name in _NAMED if not suffix else (n for n in _NAMED if "/" not in n):
            if dimension_of_unit(name + suffix) == factors:
                return name + suffix
    above = [f"{b}{round(v) if v != 1 else ''}" for b, v in factors.items() if v > 0]
    below = [f"{b}{round(-v) if v != -1 else ''}" for b, v in factors.items() if v < 0]
    if not below:
        return ".".join(above) or "1"
    bottom = below[0] if len(below) == 1 else f"({'.'.join(below)})"
    return f"{'.'.join(above) or '1'}/{bottom}"
