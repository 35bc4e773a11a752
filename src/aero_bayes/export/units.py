"""Modelica unit expressions -> SI base units."""

from __future__ import annotations

import re

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

_DERIVED: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
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
    "rpm": (0.10471975511965977, {"rad": 1, "s": -1}),
}
_PREFIX = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
_FACTOR = re.compile(r"([A-Za-z]+|1)([+-]?\d+)?$")


def base_units(unit: str) -> tuple[float, dict[str, int]] | None:
    """Factor and exponents of the SI base units, or None where the expression is not understood.

    ``unit`` follows the Modelica grammar: ``N.m.s2/rad2``, ``kg.m2``, ``1/V``, ``(m.s)/(kg)``.
    """
    total = dict.fromkeys(BASE, 0)
    scale = 1.0
    for place, part in enumerate(unit.split("/")):
        if place > 1:
            return None
        for item in part.strip().removeprefix("(").removesuffix(")").split("."):
            match = _FACTOR.match(item.strip())
            known = _symbol(match[1]) if match else None
            if match is None or known is None:
                return None
            power = int(match[2] or 1) * (1 if place == 0 else -1)
            scale *= known[0] ** power
            for base, exponent in known[1].items():
                total[base] += exponent * power
    return scale, {k: v for k, v in total.items() if v}


def _symbol(name: str) -> tuple[float, dict[str, int]] | None:
    if name in _DERIVED:
        return _DERIVED[name]
    if len(name) > 1 and name[0] in _PREFIX and name[1:] in _DERIVED and name[1:] != "1":
        factor, exponents = _DERIVED[name[1:]]
        return factor * _PREFIX[name[0]], exponents
    return None
