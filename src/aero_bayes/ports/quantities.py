"""The physical kind of a state, by its unit: a motion, a current, or the level of a storage."""

from __future__ import annotations

from collections.abc import Mapping

from aero_bayes.language.dimensions import dimension_of_unit
from aero_bayes.language.syntax import names_in
from aero_bayes.ports.aliases import AliasStructure
from aero_bayes.ports.port import PortKind

SPEEDS = ({"rad": 1.0, "s": -1.0}, {"m": 1.0, "s": -1.0})


def unit_in(s: AliasStructure, cls: str) -> str:
    return next((u for n in (cls, *s.members(cls)) if (u := s.variables[n].unit)), s.units.get(cls, ""))


def is_current(s: AliasStructure, cls: str) -> bool:
    return unit_in(s, cls) == "A"


def kind_of(s: AliasStructure, state: str, position: str) -> PortKind:
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


def units_of(s: AliasStructure, kind: PortKind, signals: Mapping[str, str], unit: str) -> dict[str, str]:
    return {**{k: unit_in(s, n) for k, n in signals.items()}, _ACTS[kind]: unit}


def owner_of(s: AliasStructure, name: str) -> str:
    """Return the component to which a variable, or its connector, belongs; empty for the model itself."""
    owner = name.rpartition(".")[0]
    of_connector = any(v.flow and n.rpartition(".")[0] == owner for n, v in s.variables.items())
    return owner.rpartition(".")[0] if owner and of_connector else owner


def is_relative_motion(s: AliasStructure, state: str) -> bool:
    """Return whether a state is the distance of two ends of a component, whose derivative is no state."""
    rate = s.rates.get(state)
    inside = "." in state and unit_in(s, state) in ("m", "rad")
    return inside and rate is not None and rate not in s.states and dimension_of_unit(unit_in(s, rate)) in SPEEDS


def is_prescribed(s: AliasStructure, state: str) -> bool:
    """Return whether a state is the prescribed potential of a source, which does not depend on the flow."""
    held = {n for x, r in s.rates.items() for n in s.members(x) if state in (x, r)} | set(s.members(state))
    owner = owner_of(s, state)
    flows = {n for n, v in s.variables.items() if v.flow and n.startswith(f"{owner}.")} if owner else set()
    ends = {n.rpartition(".")[0] for n in flows}
    moved = {s.moving[n] for n in held}
    if not any(n.rpartition(".")[0] in ends and n not in flows and s.moving.get(n) in moved for n in s.moving):
        return False
    # variables on which the derivative depends within the component
    inner = [names_in(e.left) | names_in(e.right) for e in s.flat.equations if e.component == owner]
    reached, grown = set(held), True
    while grown:
        more = set().union(*(names for names in inner if names & reached)) - reached
        more = {n for n in more if n in s.variables and not s.variables[n].constant}
        reached |= more
        grown = bool(more)
    return not reached & flows
