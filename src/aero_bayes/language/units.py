"""Modelica unit expressions -> SI base units."""

from __future__ import annotations

import re

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

_DERIVED: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "%": (1e-2, {}),
    "g": (1e-3, {"kg": 1}),
    "m": (1.0, {"m": 1}),
    "s": (1.0, {"s": 1}),
    "A": (1.0, {"A": 1}),
    "K": (1.0, {"K": 1}),
    "mol": (1.0, {"mol": 1}),
    "cd": (1.0, {"cd": 1}),
    "rad": (1.0, {"rad": 1}),
    "sr": (1.0, {"rad": 2}),
    "Hz": (1.0, {"s": -1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "C": (1.0, {"A": 1, "s": 1}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "F": (1.0, {"kg": -1, "m": -2, "s": 4, "A": 2}),
    "Ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "S": (1.0, {"kg": -1, "m": -2, "s": 3, "A": 2}),
    "Wb": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -1}),
    "T": (1.0, {"kg": 1, "s": -2, "A": -1}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
    "deg": (0.017453292519943295, {"rad": 1}),
    "rev": (6.283185307179586, {"rad": 1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "l": (1e-3, {"m": 3}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
    "atm": (101325.0, {"kg": 1, "m": -1, "s": -2}),
    "psi": (6894.757293168361, {"kg": 1, "m": -1, "s": -2}),
    "rpm": (0.10471975511965977, {"rad": 1, "s": -1}),
}
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


def _symbol(name: str) -> tuple[float, dict[str, int]] | None:
    if name in _DERIVED:
        return _DERIVED[name]
    if len(name) > 1 and name[0] in _PREFIX and name[1:] in _DERIVED and name[1:] not in ("1", "%"):
        factor, exponents = _DERIVED[name[1:]]
        return factor * _PREFIX[name[0]], exponents
    return None


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
