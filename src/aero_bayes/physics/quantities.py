"""What a state is, by its unit and by what it is the derivative of: a motion, a current, or the level of a storage."""

from __future__ import annotations

from collections.abc import Mapping

from aero_bayes.physics.ports import PortKind
from aero_bayes.physics.structure import Structure
from aero_bayes.physics.terms import dimension_of_unit

SPEEDS = ({"rad": 1.0, "s": -1.0}, {"m": 1.0, "s": -1.0})


def unit_in(s: Structure, cls: str) -> str:
    return next((u for n in (cls, *s.members(cls)) if (u := s.variables[n].unit)), "")


def is_current(s: Structure, cls: str) -> bool:
    return unit_in(s, cls) == "A"


def kind_of(s: Structure, state: str, position: str) -> PortKind:
    if is_current(s, state):
        return "electrical"
    if position or dimension_of_unit(unit_in(s, state)) in SPEEDS:
        return "motion"
    return "storage"


def signals_of(kind: PortKind, state: str, position: str) -> dict[str, str]:
    if kind == "electrical":
        return {"i": state}
    if kind == "storage":
        return {"h": state}
    return {"v": state, "x": position} if position else {"v": state}


_ACTS: Mapping[PortKind, str] = {"motion": "f", "storage": "q", "electrical": "v"}


def units_of(s: Structure, kind: PortKind, signals: Mapping[str, str], unit: str) -> dict[str, str]:
    return {**{k: unit_in(s, n) for k, n in signals.items()}, _ACTS[kind]: unit}
