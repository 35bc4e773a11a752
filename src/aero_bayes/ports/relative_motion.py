"""Ports between two motions, for laws that act on both and depend on their relative motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

from aero_bayes.export.flat import FlatEquation
from aero_bayes.language.syntax import Call, Expression, Name, walk
from aero_bayes.ports.aliases import AliasStructure, is_derivative
from aero_bayes.ports.connections import connecting_components
from aero_bayes.ports.port import DIFFERENCE, Port
from aero_bayes.ports.quantities import is_relative_motion, owner_of, unit_in


def relative_motions(s: AliasStructure, balances: Sequence[Port]) -> Iterator[Port]:
    """Yield ports for two motions whose difference of positions or speeds occurs in the model's own class.

    At connections, these are two motions that a component connects, unless its distance is a port already."""
    moving = [p for p in balances if p.kind == "motion" and p.balance is not None]
    apart, known = (
        all_differences(s),
        {owner_of(s, p.id) for p in moving if p.attachment == "equation" and is_relative_motion(s, s.of(p.id))},
    )
    for first, second in combinations(moving, 2):
        distance = _distance(s, first, second)
        one, other = (second, first) if distance and distance[1] else (first, second)
        shared = one.signals.keys() & other.signals.keys()
        alike = all(one.units[name] == other.units[name] for name in ("v", "f"))
        if one.attachment == other.attachment == "node":
            both = connecting_components(s, one, other)
            coupled = bool(both) and not both & known
        else:
            coupled = any(frozenset(s.of(p.signals[name]) for p in (one, other)) in apart for name in shared)
            coupled = coupled and all(p.attachment == "equation" and not _inside(s, p) for p in (one, other))
        if not alike or not coupled:
            continue
        signals = {
            name: f"{one.signals[name]}{DIFFERENCE}{other.signals[name]}" for name in one.signals if name in shared
        }
        units = {name: unit for name, unit in one.units.items() if name in (*signals, "f")}
        if distance and "x" not in signals:
            signals["x"], units["x"] = distance[0], unit_in(s, s.of(distance[0]))
        yield replace(
            one, id=f"{one.id}-{other.id}", signals=signals, units=units, neighbours=(other.id,),
            states=tuple(dict.fromkeys((*one.states, *other.states))),
        )  # fmt: skip


def _distance(s: AliasStructure, one: Port, other: Port) -> tuple[str, bool] | None:
    """Return a state whose derivative is the difference of two speeds, and whether the first speed is subtracted."""
    speeds = s.of(one.signals["v"]), s.of(other.signals["v"])
    for e in s.flat.equations:
        for rate, difference in ((e.left, e.right), (e.right, e.left)):
            match difference:
                case Call("-", (Name(a, ()), Name(b, ()))) if state := is_derivative(rate):
                    if {s.of(a), s.of(b)} == {*speeds}:
                        return state, s.of(a) != speeds[0]
    return None


def balance_of(s: AliasStructure, port: Port) -> FlatEquation:
    """Return the balance equation of a port."""
    assert port.balance is not None
    return next(e for e, o in zip(s.flat.equations, s.origins, strict=True) if o[0] == port.balance.equation)


def _inside(s: AliasStructure, port: Port) -> bool:
    return bool(balance_of(s, port).component)


def all_differences(s: AliasStructure) -> set[frozenset[str]]:
    """Return pairs of variables whose difference occurs in the model."""
    return {pair for e in s.flat.equations for side in (e.left, e.right) for pair in differences_in(s, side)}


def differences_in(s: AliasStructure, tree: Expression) -> Iterator[frozenset[str]]:
    """Yield pairs of variables whose difference occurs in an expression."""
    for t in walk(tree):
        match t:
            case Call("-", (Name(a, ()), Name(b, ()))) if a in s.same and b in s.same:
                yield frozenset((s.of(a), s.of(b)))
