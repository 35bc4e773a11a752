"""Ports between a state and an input: an ambient temperature, the wind, a moving base."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from aero_bayes.modelica.syntax import Expression, Name, children, names_in
from aero_bayes.structure.aliases import AliasStructure, derived_names
from aero_bayes.structure.balance import DIFFERENCE, KELVIN, Port
from aero_bayes.structure.relative_motion import all_differences, balance_of, differences_in, unit_in


def ambient_differences(s: AliasStructure, balances: Sequence[Port]) -> Iterator[Port]:
    """Yield ports at differences of a state and an input.

    There is a port where the difference occurs in an equation, and for each storage of heat with each temperature that
    is an input. An input that is the ambient level of one storage is so for all storages of the same unit."""
    fed = _input_classes(s)
    apart = all_differences(s)
    levels = {s.of(p.signals["h"]): p.units["h"] for p in balances if p.kind == "storage"}
    around = {(cls, unit) for level, unit in levels.items() for cls in fed if frozenset((level, cls)) in apart}
    for port in balances:
        if port.kind == "storage" and port.attachment in ("equation", "node"):
            unit = port.units["h"]
            for cls, name in fed.items():
                if (unit in KELVIN and unit_in(s, cls) == unit) or (cls, unit) in around:
                    yield replace(
                        port, id=f"{port.id}-{name}", signals={**port.signals, "h_s": name}, neighbours=(),
                    )  # fmt: skip
        elif port.kind == "motion" and port.attachment == "equation":
            acting = _acting(s, port)
            other = {
                signal: next((name for cls, name in fed.items() if frozenset((s.of(own), cls)) in acting), "")
                for signal, own in port.signals.items()
            }
            signals = {n: f"{port.signals[n]}{DIFFERENCE}{name}" for n, name in other.items() if name}
            if signals:
                units = {n: unit for n, unit in port.units.items() if n in (*signals, "f")}
                name = other.get("v") or other["x"]
                yield replace(port, id=f"{port.id}-{name}", signals=signals, units=units, neighbours=())


def _input_classes(s: AliasStructure) -> dict[str, str]:
    """Return variables that depend on inputs alone: by alias class, the name with the fewest dots."""
    seen = {n for n, v in s.variables.items() if n in s.same and "[" not in n and not (v.protected and "." in n)}
    found = {s.of(n): n for n, v in s.variables.items() if v.causality == "input" and "." not in n and n in seen}
    grown = True
    while grown:
        grown = False
        for e in s.flat.equations:
            for one, whole in ((e.left, e.right), (e.right, e.left)):
                if not isinstance(one, Name) or one.name not in s.same or s.of(one.name) in found:
                    continue
                varying = {s.of(n) for n in names_in(whole) if n in s.variables and not s.variables[n].constant}
                if varying and varying <= found.keys() and not [*derived_names(whole)]:
                    members = [n for n in s.members(s.of(one.name)) if n in seen]
                    if members:
                        found[s.of(one.name)] = min(members, key=lambda n: n.count("."))
                        grown = True
    return found


def _acting(s: AliasStructure, port: Port) -> set[frozenset[str]]:
    """Return pairs of variables whose difference is part of a motion's balance, or of what gives a force there.

    A difference from which a controller forms a voltage is no place in the mechanics."""
    own, unit = balance_of(s, port), port.units.get("f", "")

    def gives_force(tree: Expression) -> bool:
        return isinstance(tree, Name) and tree.name in s.same and unit_in(s, s.of(tree.name)) == unit

    equations = [e for e in s.flat.equations if e is own or gives_force(e.left) or gives_force(e.right)]
    return {pair for e in equations for side in (e.left, e.right) for pair in _inside(s, side)}


def _inside(s: AliasStructure, tree: Expression) -> Iterator[frozenset[str]]:
    """Yield pairs of variables whose difference is a proper part of an expression."""
    for inner in children(tree):
        yield from differences_in(s, inner)
