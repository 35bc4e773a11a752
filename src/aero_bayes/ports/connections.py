"""Ports at connections: a node, or a voltage drop in series."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from aero_bayes.export.flat import FlatEquation
from aero_bayes.language.syntax import Expression, Name, Number, names_in, summands
from aero_bayes.ports.aliases import AliasStructure, derived_in
from aero_bayes.ports.balance import Balance
from aero_bayes.ports.port import Port
from aero_bayes.ports.quantities import is_current, kind_of, owner_of, signals_of, unit_in, units_of


def _flow_sums(s: AliasStructure) -> Iterator[tuple[int, list[str]]]:
    """Yield equations that sum the flows of a connection set in the model's own class, with the names of the flows."""
    flow = {v.name for v in s.flat.variables if v.flow}
    for i, e in enumerate(s.flat.equations):
        if e.origin == "flow" and s.origins[i][1] == 0:
            names = _sum_names(e.left)
            if names and all(n in flow and n.count(".") == 2 for n in names):
                yield i, names


def _sum_names(tree: Expression) -> list[str]:
    return [t.name for _, t in summands(tree) if isinstance(t, Name)]


def _potential(s: AliasStructure, connector: str) -> str:
    """Return the local name of the only potential variable of a connector; empty if there are several."""
    inner = [n for n, v in s.variables.items() if n.startswith(connector + ".") and not v.flow]
    return inner[0].rpartition(".")[2] if len(inner) == 1 and inner[0].rpartition(".")[0] == connector else ""


def node_port(s: AliasStructure, state: str, position: str) -> Port | None:
    """Find a port at a node whose potential is the state or its position, first at the state's own component."""
    owner = owner_of(s, state)
    choices: list[tuple[bool, int, list[str], str]] = []
    for i, flows in _flow_sums(s):
        connectors = [f.rpartition(".")[0] for f in flows]
        potential = _potential(s, connectors[0])
        end = f"{connectors[0]}.{potential}"
        if potential and (s.of(end) in (state, position) or (position and s.moving[end] == s.moving[position])):
            connectors.sort(key=lambda c: not c.startswith(owner + "."))
            choices.append((not connectors[0].startswith(owner + "."), i, connectors, potential))
    if not choices:
        return None
    _, index, connectors, potential = min(choices, key=lambda c: c[:2])
    flow = s.flat.equations[index]
    name = _sum_names(flow.left)[0].rpartition(".")[2]
    v = s.variables[f"{connectors[0]}.{name}"]
    kind = kind_of(s, state, position)
    if kind == "electrical":
        return None
    end = f"{connectors[0]}.{potential}"
    if position and s.of(end) not in (state, position):
        position = end  # it differs from the position of the state by a constant
    signals = signals_of(kind, state, position)
    return Port(
        connectors[0], kind, "node", v.unit, units_of(s, kind, signals, v.unit), s.variables[state].place,
        (position, state) if position else (state,), signals, Balance(s.origins[index][0], Number(1.0), v.unit),
        tuple(connectors), name, potential,
    )  # fmt: skip


def connecting_components(s: AliasStructure, one: Port, other: Port) -> set[str]:
    """Return components with a connector at each of two nodes, and without a state at either."""
    both: list[set[str]] = []
    for port in (one, other):
        motion = s.moving[f"{port.connectors[0]}.{port.potential}"][0]
        ends = (flow.rpartition(".")[0] for _, flows in _flow_sums(s) for flow in flows)
        both.append({owner_of(s, f"{c}.{port.flow}") for c in ends if _motion_of(s, c, port.potential) == motion})
    return set.intersection(*both) - {owner_of(s, x) for p in (one, other) for x in p.states}


def _motion_of(s: AliasStructure, connector: str, potential: str) -> str:
    """Return the representative of the potential of a connector; empty if it has no such potential."""
    return s.moving.get(f"{connector}.{potential}", ("", 1))[0]


def series_port(s: AliasStructure, state: str) -> Port | None:
    """Return a port in series in a connection of two connectors whose flow is the state, a current."""
    if not is_current(s, state):
        return None
    owner = owner_of(s, state) + "."
    pairs = [flows for _, flows in _flow_sums(s) if len(flows) == 2 and s.of(flows[0]) == state]
    for flows in sorted(pairs, key=lambda f: not any(n.startswith(owner) for n in f)):
        connectors = [f.rpartition(".")[0] for f in flows]
        ends = {f"{c}.{_potential(s, connectors[0])}" for c in connectors}
        for e in s.flat.equations:
            if e.origin == "connection" and names_in(e.left) | names_in(e.right) == ends and isinstance(e.left, Name):
                left = e.left.name.rpartition(".")[0]
                right = next(c for c in connectors if c != left)
                own = next((c for c in connectors if c.startswith(owner)), left)
                return _series_port_at(s, state, own, (left, right), flows[0].rpartition(".")[2])
    return None


def storage_pin_port(s: AliasStructure, state: str) -> Port | None:
    """Return a port in series at a pin of a component whose state is a voltage, such as a capacitor."""
    owner = owner_of(s, state) + "."
    if unit_in(s, state) != "V":
        return None
    pins = [(f, flows) for _, flows in _flow_sums(s) for f in flows if f.startswith(owner) and len(flows) > 1]
    return _series_port_before_pin(s, state, pins) if pins else None


def branch_ports(s: AliasStructure, taken: Iterable[Port]) -> Iterator[Port]:
    """Yield ports in series at pins of components without a state: one in each branch without any."""
    seen = {s.moving[p.signals["i"]][0] for p in taken if p.kind == "electrical"}
    sets = [flows for _, flows in _flow_sums(s) if len(flows) > 1]
    for i, e in enumerate(s.flat.equations):
        names = names_in(e.left) | names_in(e.right)
        currents = {s.of(n) for n in names if n in s.same and unit_in(s, s.of(n)) == "A"}
        volts = any(n in s.same and s.variables[n].unit == "V" for n in names)
        if e.component.count(".") or not volts or len(currents) != 1 or i in s.plain or derived_in(e):
            continue
        (current,) = currents
        pins = [(f, flows) for flows in sets for f in flows if f.startswith(f"{e.component}.") and s.of(f) == current]
        if pins and s.moving[current][0] not in seen:
            seen.add(s.moving[current][0])
            at = next(n for n in sorted(names) if n in s.same and s.of(n) == current)
            yield replace(_series_port_before_pin(s, "", pins), place=s.variables[at].place)


def _series_port_before_pin(s: AliasStructure, state: str, pins: Iterable[tuple[str, list[str]]]) -> Port:
    """Return a port in series at the pin that is declared first."""
    order = list(s.variables)
    flow, flows = min(pins, key=lambda one: order.index(one[0]))
    pin, name = flow.rpartition(".")[::2]
    other = next(f for f in flows if f != flow).rpartition(".")[0]
    return _series_port_at(s, state, pin, (other, pin), name)


def _series_port_at(s: AliasStructure, state: str, own: str, connectors: tuple[str, str], flow: str) -> Port:
    """Return a port in series before the second of two connectors. Laws read the current into that connector."""
    potential = _potential(s, own)
    end = f"{connectors[1]}.{potential}"
    at = next(i for i, e in enumerate(s.flat.equations) if _connects_to(e, end))
    unit, signals = s.variables[end].unit, {"i": f"{connectors[1]}.{flow}"}
    place = s.variables[state or signals["i"]].place
    return Port(
        own, "electrical", "series", unit, units_of(s, "electrical", signals, unit), place,
        (state,) if state else (), signals, Balance(s.origins[at][0], Number(-1.0), unit), connectors, flow,
        potential,
    )  # fmt: skip


def _connects_to(e: FlatEquation, end: str) -> bool:
    return e.origin == "connection" and end in names_in(e.left) | names_in(e.right)
