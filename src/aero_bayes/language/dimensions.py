"""Dimensions: exponents of units, those of expressions, and units by their exponents."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence

from aero_bayes.language.syntax import DIVIDES, Call, Expression, Name, Number, factors, short_text, summands
from aero_bayes.language.units import base_units, symbols_of
from aero_bayes.language.values import OPERATORS

#: Functions whose value has the dimension of their argument.
_SAME = frozenset({"abs", "min", "max", "noEvent", "smooth", "homotopy", "diagonal", "transpose", "vector", "sum"})
_NAMED = (
    "N", "N.m", "V", "A", "W", "Pa", "Ohm", "C", "m3/s", "kg/s", "N.s/m", "N/m", "H", "F",
)  # fmt: skip
#: Temperatures that are counted from elsewhere: their differences are in K, or in shares of it.
_DEGREES = re.compile(r"\b(degC|degF|Cel)(?![A-Za-z])")

Dimension = Mapping[str, float]


def dimension(tree: Expression, of: Callable[[str], Dimension | None]) -> Dimension | None:
    """Return exponents of the base units, or None where they are not known. A number alone says nothing."""
    match tree:
        case Name():
            return of(short_text(tree))
        case Call("+" | "-" | ".+" | ".-" | "neg"):
            terms = [t for _, t in summands(tree)]
            known = next((d for t in terms if (d := dimension(t, of)) is not None), None)
            return {} if known is None and any(isinstance(t, Number) for t in terms) else known
        case Call("*" | "/" | ".*" | "./"):
            return _product([(o, dimension(f, of)) for o, f in factors(tree) if not isinstance(f, Number)])
        case Call("^" | ".^", (base, Number(power))):
            return _scaled(dimension(base, of), power)
        case Call("sqrt", (one,)):
            return _scaled(dimension(one, of), 0.5)
        case Call("der", (one,)):
            return _product([("*", dimension(one, of)), ("/", {"s": 1.0})])
        case Call("cross", (one, two)):
            return _product([("*", dimension(one, of)), ("*", dimension(two, of))])
        case Call(function, (*_, last)) if function in _SAME:
            return dimension(last, of)
        case Call(function, _) if function not in OPERATORS and function != "not":
            return {}
    return None


def _product(known: Sequence[tuple[str, Dimension | None]]) -> Dimension | None:
    total: dict[str, float] = {}
    for operator, own in known:
        if own is None:
            return None
        for base, exponent in own.items():
            total[base] = total.get(base, 0.0) + (-exponent if operator in DIVIDES else exponent)
    return _clean(total)


def _scaled(own: Dimension | None, by: float) -> Dimension | None:
    return None if own is None else _clean({k: v * by for k, v in own.items()})


def has_number(tree: Expression) -> bool:
    """Return whether a number is a factor in a term; what is added to one is a number itself."""
    is_product = isinstance(tree, Call) and tree.function in ("*", "/", ".*", "./")
    return is_product and any(isinstance(f, Number) and f.value != -1.0 for _, f in factors(tree))


def _clean(total: Mapping[str, float]) -> Dimension:
    return {k: v for k, v in total.items() if abs(v) > 1e-9}


def dimension_of_unit(unit: str) -> Dimension | None:
    """Return exponents of the base units of a unit expression; None where it is empty or not understood.

    A temperature in degC is one."""
    known = base_units(_DEGREES.sub("K", unit)) if unit else None
    return None if known is None else {k: float(v) for k, v in known[1].items()}


def without_angle(dim: Dimension) -> Dimension:
    """Drop the angle, since torques are given in N.m as often as in N.m/rad: a radian is a number."""
    return {k: v for k, v in dim.items() if k != "rad"}


def unit_factors(unit: str) -> Dimension | None:
    """Return the exponents of the unit's own symbols, ``N.s/m`` as N, s and 1/m; None where it is not understood."""
    if base_units(unit) is None:
        return None
    return _product([("*", {symbol: float(power)}) for symbol, power in symbols_of(unit) if symbol not in ("1", "%")])


def in_base_units_if_scaled(factors: Dimension | None) -> Dimension | None:
    """Return symbols whose scales cancel, in base units: ``kg.l/(s.m3.g)`` is ``1/s``. Others stay."""
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
    """Return a unit expression of such exponents; empty where they are unknown or not whole."""
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
