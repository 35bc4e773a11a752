"""Dimensions: exponents of units, those of expressions, and units by their exponents."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache

from aero_bayes.modelica.parse import OPERATORS
from aero_bayes.modelica.syntax import DIVIDES, Call, Expression, Name, Number, factors, short_text, summands

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

#: Other units: how many of which one they are.
_DERIVED: dict[str, tuple[float, str]] = {
    "%": (1e-2, "1"), "g": (1e-3, "kg"), "sr": (1.0, "rad2"), "Hz": (1.0, "1/s"), "N": (1.0, "kg.m/s2"),
    "Pa": (1.0, "N/m2"), "J": (1.0, "N.m"), "W": (1.0, "J/s"), "C": (1.0, "A.s"), "V": (1.0, "W/A"), "F": (1.0, "C/V"),
    "Ohm": (1.0, "V/A"), "S": (1.0, "A/V"), "Wb": (1.0, "V.s"), "T": (1.0, "Wb/m2"), "H": (1.0, "Wb/A"),
    "deg": (0.017453292519943295, "rad"), "rev": (6.283185307179586, "rad"), "min": (60.0, "s"), "h": (3600.0, "s"),
    "l": (1e-3, "m3"), "bar": (1e5, "Pa"), "atm": (101325.0, "Pa"), "psi": (6894.757293168361, "Pa"),
    "rpm": (0.10471975511965977, "rad/s"),
}  # fmt: skip
#: Temperatures: their zero and their degree, both in K.
TEMPERATURES = {"K": (0.0, 1.0), "degC": (273.15, 1.0), "degF": (459.67 / 1.8, 1.0 / 1.8)}
#: Standard gravity, in m/s2.
GRAVITY = 9.80665
#: What units are called by hand, as the grammar spells them.
_BY_HAND = {
    "ohm": "Ohm", "Ω": "Ohm", "Nm": "N.m", "sec": "s", "degree": "deg", "degrees": "deg", "°": "deg", "°C": "degC",
    "Celsius": "degC", "L": "l", "-": "1", "Ah": "A.h", "mAh": "mA.h", "Wh": "W.h", "kWh": "kW.h",
}  # fmt: skip
_PREFIX = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
#: Units that are written out, also with the mistakes that are made in it.
_WRITTEN_OUT = re.compile(
    r"(mill?i|kilo|mega|micro|centi)?"
    r"(amp|volt|watt|met|gram|newton|second|hertz|radian|joule|pascal|kelvin|ohm)(?:er|re|ere|me)?s?"
)
_LETTERS = {"met": "m", "gram": "g", "second": "s", "hertz": "Hz", "radian": "rad", "pascal": "Pa", "ohm": "Ohm"}
_PREFIXES = {"mega": "M", "micro": "u"}
_ITEM = r"(?:1|[^\W\d_]+|[%°])"
_PRODUCT = rf"{_ITEM}(?:[+-]?\d+)?(?:\.{_ITEM}(?:[+-]?\d+)?)*"
_GRAMMAR = re.compile(rf"(?:{_PRODUCT}|\({_PRODUCT}\))(?:/(?:{_ITEM}(?:[+-]?\d+)?|\({_PRODUCT}\)))?")
_FACTOR = re.compile(r"([A-Za-z]+|[1%])([+-]?\d+)?$")


def base_units(unit: str) -> tuple[float, dict[str, int]] | None:
    """Return factor and exponents of the SI base units, or None where the expression is not understood.

    ``unit`` follows the Modelica grammar: ``N.m.s2/rad2``, ``kg.m2``, ``1/V``, ``(m.s)/(kg)``."""
    total = dict.fromkeys(BASE, 0)
    scale = 1.0
    for symbol, power in symbols_of(unit) or [("", 0)]:
        known = _symbol(symbol)
        if known is None:
            return None
        scale *= known[0] ** power
        for base, exponent in known[1].items():
            total[base] += exponent * power
    return scale, {k: v for k, v in total.items() if v}


def symbols_of(unit: str) -> list[tuple[str, int]]:
    """Return the symbols of a unit expression with their powers, ``N.s/m`` as N, s and 1/m.

    None for what is not one."""
    found: list[tuple[str, int]] = []
    above, *below = unit.split("/")
    for part, sign in ((above, 1), *((p, -1) for p in below)):
        for item in part.strip().removeprefix("(").removesuffix(")").split("."):
            match = _FACTOR.match(item.strip())
            if match is None or len(below) > 1:
                return []
            found.append((match[1], sign * int(match[2] or 1)))
    return found


@cache
def _symbol(name: str) -> tuple[float, dict[str, int]] | None:
    if name == "1" or name in BASE:
        return 1.0, {} if name == "1" else {name: 1}
    if name in _DERIVED:
        factor, by = _DERIVED[name]
        known = base_units(by)
        return None if known is None else (factor * known[0], known[1])
    prefixed = len(name) > 1 and name[0] in _PREFIX and name[1:] not in ("1", "%", "kg")
    known = _symbol(name[1:]) if prefixed and (name[1:] in BASE or name[1:] in _DERIVED) else None
    return None if known is None else (known[0] * _PREFIX[name[0]], known[1])


def is_unit(unit: str) -> bool:
    """Return whether a unit is one that the Modelica grammar spells, and is known."""
    return unit in TEMPERATURES or bool(unit and base_units(unit))


def unit_written_out(name: str) -> str:
    """Return the unit that a word such as ``volts`` or ``miliamp`` names; empty for another word."""
    found = _WRITTEN_OUT.fullmatch(name.lower())
    if found is None:
        return ""
    prefix, unit = found[1] or "", found[2]
    return _PREFIXES.get(prefix, prefix[:1]) + _LETTERS.get(unit, unit[0].upper())


def to_modelica_unit(unit: str) -> str:
    """Return a unit as the Modelica grammar spells it: ``kg*m^2`` is ``kg.m2``, ``m3/s/V`` is ``m3/(s.V)``.

    Empty where that cannot be done. A symbol that is not known stays."""
    text = re.sub(r"\s*(\*\*|[*·⋅./^()])\s*", r"\1", unit.strip()).replace("**", "^")
    text = re.sub(r"[*·⋅\s]", ".", text).replace("²", "2").replace("³", "3").replace("µ", "u").replace("μ", "u")
    text = re.sub(r"\^(?:\(([+-]?\d+)\)|([+-]?\d+)(?![.\d]))", lambda m: m[1] or m[2], text)
    text = re.sub(r"[^()./\d+-]+|^-$", lambda m: _BY_HAND.get(m[0], m[0]), text)
    if _GRAMMAR.fullmatch(text):
        return text
    if not text or text.count("(") != text.count(")") or re.search(r"[^()./]\(", text):
        return ""
    above: list[str] = []
    below: list[str] = []
    sign, outer = 1, [1]
    for token in re.findall(r"[()./]|[^()./]+", text):
        if token in "()./":
            outer = [*outer, outer[-1] * sign] if token == "(" else (outer[:-1] or [1]) if token == ")" else outer
            sign = -1 if token == "/" else 1
            continue
        (above if sign * outer[-1] > 0 else below).append(token)
        sign = 1
    bottom = ".".join(b for b in below if b != "1")
    text = (".".join(above) or "1") + (f"/({bottom})" if "." in bottom else f"/{bottom}" if bottom else "")
    return text if _GRAMMAR.fullmatch(text) else ""


def conversion(unit: str, to: str) -> tuple[float, float] | None:
    """Return factor and offset that turn a number in one unit into a number in another; None where none does."""
    one, other = to_modelica_unit(unit), to_modelica_unit(to)
    if one in TEMPERATURES and other in TEMPERATURES:
        (zero, degree), (new_zero, new_degree) = TEMPERATURES[one], TEMPERATURES[other]
        return degree / new_degree, (zero - new_zero) / new_degree
    own, wanted = base_units(one), base_units(other)
    if one == "g" and wanted is not None and wanted[1] == {"m": 1, "s": -2}:
        own = (GRAVITY, wanted[1])  # what an accelerometer reads in, not a gram
    if own is None or wanted is None or own[1] != wanted[1]:
        return (1.0, 0.0) if one and one == other else None
    return own[0] / wanted[0], 0.0


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
