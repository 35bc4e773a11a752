"""Ports between two motions: laws that act on both and depend on their relative motion."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

from aero_bayes.laws.aliases import AliasStructure, derived_in, is_derivative
from aero_bayes.laws.balance import (
    LOAD,
    PORT_KINDS,
    Balance,
    Port,
    PortKind,
    Signal,
    find_balance,
    parameter_values,
)
from aero_bayes.laws.insertion_point import Driver, sign_of_factor
from aero_bayes.modelica.flat import FlatEquation, FlatVariable
from aero_bayes.modelica.graphs import reachable
from aero_bayes.modelica.syntax import Call, Expression, Name, Number, names_in, summands, walk
from aero_bayes.modelica.units import Dimension, dimension_of_unit

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


def signals_of(kind: PortKind, *names: str) -> dict[str, Signal]:
    """Return the signals at a port of a kind by the names of their variables, which may be empty."""
    return {signal: Signal.of(n) for signal, n in zip(PORT_KINDS[kind].signals, names, strict=False) if n}


def units_of(s: AliasStructure, kind: PortKind, signals: Mapping[str, Signal], unit: str) -> dict[str, str]:
    return {**{k: unit_in(s, s.of(given.first)) for k, given in signals.items()}, PORT_KINDS[kind].acts: unit}


def is_load(s: AliasStructure, given: Signal, own: Collection[Signal]) -> bool:
    """Return whether the rest of a balance is a load: not of its own motion alone, nor with another acceleration."""
    read = names_in(given.expression)
    moving = {s.of(n) for signal in own for n in names_in(signal.expression)}
    others = {s.of(n) for n in read if n in s.variables and not s.variables[n].constant} - moving
    return bool(others) and not others & (set(s.rates.values()) - set(s.states))


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
    inner = [{n for n in names if n in held or (n in s.variables and not s.variables[n].constant)} for names in inner]
    reached = reachable(held, lambda name: (n for names in inner if name in names for n in names))
    return not reached.keys() & flows


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
        moved = [c for c in ends if s.moving.get(f"{c}.{port.potential}", ("", 1))[0] == motion]
        both.append({owner_of(s, f"{c}.{port.flow}") for c in moved})
    return set.intersection(*both) - {owner_of(s, x) for p in (one, other) for x in p.states}


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
    seen = {s.moving[p.signals["i"].first][0] for p in taken if p.kind == "electrical"}
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
    joins = ((i, e) for i, e in enumerate(s.flat.equations) if e.origin == "connection")
    at = next(i for i, e in joins if end in names_in(e.left) | names_in(e.right))
    unit, current = s.variables[end].unit, f"{connectors[1]}.{flow}"
    signals = signals_of("electrical", current)
    place = s.variables[state or current].place
    return Port(
        own, "electrical", "series", unit, units_of(s, "electrical", signals, unit), place,
        (state,) if state else (), signals, Balance(s.origins[at][0], Number(-1.0), unit), connectors, flow,
        potential,
    )  # fmt: skip


#: Dimensions of a force, a torque and a voltage, each with the signals on which it depends; the first must be there.
_RESISTING: tuple[tuple[PortKind, Dimension, Mapping[str, Dimension]], ...] = (
    ("motion", {"kg": 1.0, "m": 1.0, "s": -2.0}, {"v": {"m": 1.0, "s": -1.0}, "x": {"m": 1.0}}),
    ("motion", {"kg": 1.0, "m": 2.0, "s": -2.0}, {"v": {"rad": 1.0, "s": -1.0}, "x": {"rad": 1.0}}),
    ("electrical", dimension_of_unit("V") or {}, {"i": {"A": 1.0}}),
)


def force_outputs(s: AliasStructure, taken: Collection[int]) -> Iterator[Port]:
    """Yield ports at outputs that are forces or torques and depend on one speed, or voltages and on one current.

    A law there is added to the force with the sign of what resists the speed, to the voltage with that of a resistance.
    """
    values = parameter_values(s.flat)
    units = {v.name: v.unit for v in s.flat.variables}
    for v in s.flat.variables:
        if v.causality != "output" or "." in v.name or v.type != "Real" or v.sizes or v.constant:
            continue
        resisting = next((r for r in _RESISTING if dimension_of_unit(v.unit) == r[1]), None)
        given = None if resisting is None else _given_by(s, v, taken)
        if resisting is None or given is None:
            continue
        kind, _, wanted = resisting
        index, whole = given
        signals = {signal: own for signal, of in wanted.items() if (own := _one_signal(s, whole, of)) is not None}
        moving = signals.get(next(iter(wanted)))
        balance = find_balance(s.flat, index, _is_name(v.name), values, units)
        if moving is None or balance is None:
            continue
        # positive where the speed or current is no factor of a term
        if (sign_of_factor(whole, _is_name(moving.first), values) or 1) > 0:
            balance = replace(balance, scale=Call("neg", (balance.scale,)), sign=-1)
        known = units_of(s, kind, signals, v.unit)
        if kind == "motion" and balance.load is not None and is_load(s, balance.load, signals.values()):
            signals, known = {**signals, LOAD: balance.load}, {**known, LOAD: v.unit}
        yield Port(
            v.name, kind, "equation", v.unit, known, s.flat.equations[index].place,
            tuple(s.states_in(whole)), signals, replace(balance, equation=s.origins[index][0], force=v.name),
        )  # fmt: skip


def _given_by(s: AliasStructure, v: FlatVariable, taken: Collection[int]) -> tuple[int, Expression] | None:
    """Return the equation of the model's own class that gives an output explicitly, and what it gives."""
    for index, e in enumerate(s.flat.equations):
        equation, row, _ = s.origins[index]
        own = not e.component and e.origin in ("component", "binding") and not row
        if own and index not in s.plain and equation not in taken:
            for one, whole in ((e.left, e.right), (e.right, e.left)):
                if (
                    isinstance(one, Name)
                    and one.name == v.name
                    and not one.subscripts
                    and v.name not in names_in(whole)
                ):
                    return index, whole
    return None


def _is_name(name: str) -> Driver:
    return lambda tree: isinstance(tree, Name) and tree.name == name and not tree.subscripts


def _one_signal(s: AliasStructure, tree: Expression, wanted: Dimension) -> Signal | None:
    """Find the only difference of two variables of a dimension in an expression, else the only variable or input.

    None if there is none, or more than one."""

    def fits(t: Expression) -> bool:
        known = isinstance(t, Name) and not t.subscripts and t.name in s.same
        return known and isinstance(t, Name) and dimension_of_unit(unit_in(s, s.of(t.name))) == wanted

    differences = {
        Signal.of(a.name, b.name)
        for t in walk(tree)
        if isinstance(t, Call) and t.function == "-" and len(t.args) == 2
        for a, b in [t.args]
        if isinstance(a, Name) and isinstance(b, Name) and fits(a) and fits(b)
    }
    single = {Signal.of(t.name) for t in walk(tree) if isinstance(t, Name) and fits(t)}
    inputs = {v.name for v in s.flat.variables if v.causality == "input" and "." not in v.name and fits(Name(v.name))}
    found = differences or single or {Signal.of(name) for name in inputs}
    return next(iter(found)) if len(found) == 1 else None


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
        shared = (one.signals.keys() & other.signals.keys()) - {LOAD}
        alike = all(one.units[name] == other.units[name] for name in ("v", "f"))
        if one.attachment == other.attachment == "node":
            both = connecting_components(s, one, other)
            coupled = bool(both) and not both & known
        else:
            coupled = any(frozenset(s.of(str(p.signals[name])) for p in (one, other)) in apart for name in shared)
            coupled = coupled and all(p.attachment == "equation" and not _inside(s, p) for p in (one, other))
        if not alike or not coupled:
            continue
        signals = {
            name: Signal.of(one.signals[name].first, other.signals[name].first)
            for name in one.signals
            if name in shared
        }
        units = {name: unit for name, unit in one.units.items() if name in (*signals, "f")}
        if distance and "x" not in signals:
            signals["x"], units["x"] = Signal.of(distance[0]), unit_in(s, s.of(distance[0]))
        yield replace(
            one, id=f"{one.id}-{other.id}", signals=signals, units=units, neighbours=(other.id,),
            states=tuple(dict.fromkeys((*one.states, *other.states))),
        )  # fmt: skip


def _distance(s: AliasStructure, one: Port, other: Port) -> tuple[str, bool] | None:
    """Return a state whose derivative is the difference of two speeds, and whether the first speed is subtracted."""
    speeds = s.of(one.signals["v"].first), s.of(other.signals["v"].first)
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
