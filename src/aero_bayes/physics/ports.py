"""Where a term may be missing in a model: at inputs, outputs, balances and connections. Found, not listed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from aero_bayes.export.flat import FlatEquation, FlatModel, FlatVariable, Place
from aero_bayes.export.syntax import Call, Expression, Name, Number, names_in
from aero_bayes.physics.balance import Driver
from aero_bayes.physics.entrance import Entrance, entrance_of, parameter_values
from aero_bayes.physics.laws import Law
from aero_bayes.physics.structure import Structure, structure_of
from aero_bayes.physics.terms import Term, dimension_of_unit

PortKind = Literal["input", "output", "motion", "storage", "electrical"]
Via = Literal["input", "output", "equation", "node", "series"]

_SPEEDS = ({"rad": 1.0, "s": -1.0}, {"m": 1.0, "s": -1.0})
_KELVIN = ("K", "degC", "Cel")


@dataclass(frozen=True)
class Port:
    """A place in a model where a term may be missing.

    Attributes
    ----------
    id : str
        The input, output or state; at a connection the connector. An output that is a state itself is
        ``output_<name>``, because the name stands for the balance.
    kind : str
        What acts there: ``input``, ``output``, ``motion``, ``storage`` or ``electrical``.
    via : str
        How a law is tied in: at an ``input`` or ``output``, as a term in an ``equation``, as an element at a ``node``
        or in ``series`` in a connection.
    unit : str
        Of what a law gives there: a force, a flow, a voltage, or the signal itself. Empty where nothing tells.
    units : mapping
        Unit of each signal of a law by its name there, such as ``v`` and ``x``.
    place : Place, optional
        File and line of the declaration or the equation.
    states : tuple of str
        Names of the states that act there.
    signals : mapping
        What a law is given there by the names of its partial model, as variables of the flat model.
    entrance : Entrance, optional
        The equation in which an opposing term enters, and with which factor.
    connectors : tuple of str
        At a connection, the connectors that it joins; the first is the port's own.
    flow, potential : str
        Names of the connectors' flow variable and potential.
    neighbours : tuple of str
        Ids of the storages of the same unit, those first whose balance has a state in common.
    laws : tuple of str
        Ids of the laws that fit.
    """

    id: str
    kind: PortKind
    via: Via
    unit: str
    units: Mapping[str, str]
    place: Place | None
    states: tuple[str, ...] = ()
    signals: Mapping[str, str] = field(default_factory=dict)
    entrance: Entrance | None = None
    connectors: tuple[str, ...] = ()
    flow: str = ""
    potential: str = ""
    neighbours: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()


def ports_of(flat: FlatModel, laws: Sequence[Law] = ()) -> tuple[Port, ...]:
    """All ports of a model: inputs, outputs, then balances in the order of their states.

    Parameters
    ----------
    flat : FlatModel
        Inputs, outputs, equations and connections of the model's own class count; what lies inside its components is
        reached by their connectors.
    laws : sequence of Law
        Those that are looked at for :attr:`Port.laws`.
    """
    s = structure_of(flat)
    balances = list(_balances(s))
    taken = {p.id for p in balances}
    outputs = [replace(p, id=f"output_{p.id}") if p.id in taken else p for p in _outputs(s)]
    ports = [*_inputs(flat), *outputs, *balances]
    ports = [replace(p, neighbours=_neighbours(p, ports)) for p in ports]
    return tuple(replace(p, laws=tuple(law.id for law in laws if fits(law, p))) for p in ports)


def fits(law: Law, port: Port) -> bool:
    """Whether a law can act at a port: its kind, the signals it needs, the unit that it asks for."""
    if law.kind in ("overflow", "exchange"):
        return port.kind == "storage" and (law.kind == "overflow" or bool(port.neighbours))
    if law.kind != port.kind or not law.uses <= port.signals.keys():
        return False
    return all(
        port.units.get(signal) == unit or (unit == "K" and port.units.get(signal) in _KELVIN)
        for signal, unit in law.needs_unit.items()
    )


@dataclass(frozen=True)
class Candidate:
    """A law that may act at a port; ``neighbour`` is where what is lost may go."""

    law: Law
    port: Port
    neighbour: Port | None = None

    @property
    def id(self) -> str:
        """``law@port``."""
        return f"{self.law.id}@{self.port.id}"


def candidates(ports: Sequence[Port], laws: Sequence[Law]) -> tuple[Candidate, ...]:
    """Every law at every port that it fits, port by port.

    An exchange between two storages counts once; it and what overflows go to the first neighbour.
    """
    by_id = {p.id: p for p in ports}
    found: list[Candidate] = []
    joined: set[frozenset[str]] = set()
    for port in ports:
        first = by_id.get(port.neighbours[0]) if port.neighbours else None
        for law in (law for law in laws if fits(law, port)):
            neighbour = first if law.kind in ("overflow", "exchange") else None
            if law.kind == "exchange":
                pair = frozenset((port.id, *port.neighbours[:1]))
                if pair in joined:
                    continue
                joined.add(pair)
            found.append(Candidate(law, port, neighbour))
    return tuple(found)


def port_table(ports: Sequence[Port]) -> list[dict[str, object]]:
    """The ports as rows for a table or JSON: id, kind, unit, file, line, states, laws."""
    return [
        {
            "id": p.id,
            "kind": p.kind,
            "unit": p.unit,
            "file": p.place.file if p.place else "",
            "line": p.place.line if p.place else 0,
            "states": list(p.states),
            "laws": list(p.laws),
        }
        for p in ports
    ]


def _top(v: FlatVariable, causality: str) -> bool:
    return v.causality == causality and "." not in v.name and v.type == "Real" and not v.sizes and not v.constant


def _inputs(flat: FlatModel) -> Iterator[Port]:
    for v in flat.variables:
        if _top(v, "input"):
            yield Port(v.name, "input", "input", v.unit, {"u": v.unit, "y": v.unit}, v.place, (), {"u": v.name})


def _outputs(s: Structure) -> Iterator[Port]:
    for v in s.flat.variables:
        if _top(v, "output"):
            own = s.of(v.name)
            giving = [e for e in s.flat.equations if isinstance(e.left, Name) and e.left.name == v.name]
            states = (own,) if own in s.states else tuple(x for e in giving for x in s.states_in(e.right))
            yield Port(v.name, "output", "output", v.unit, {"u": v.unit, "y": v.unit}, v.place, states, {"u": v.name})


def _balances(s: Structure) -> Iterator[Port]:
    values = parameter_values(s.flat)
    units = {v.name: v.unit for v in s.flat.variables}
    positions = {x: r for x, r in s.rates.items() if r in s.states}
    for state in s.states:
        if state in positions and not _is_current(s, positions[state]):
            continue
        position = next((x for x, r in positions.items() if r == state), "")
        found = _series(s, state) or _equation(s, state, position, values, units) or _node(s, state, position)
        if found is not None:
            yield found


def _unit_in(s: Structure, cls: str) -> str:
    return next((u for n in (cls, *s.members(cls)) if (u := s.variables[n].unit)), "")


def _is_current(s: Structure, cls: str) -> bool:
    return _unit_in(s, cls) == "A"


def _kind(s: Structure, state: str, position: str) -> PortKind:
    if _is_current(s, state):
        return "electrical"
    if position or dimension_of_unit(_unit_in(s, state)) in _SPEEDS:
        return "motion"
    return "storage"


def _signals(kind: PortKind, state: str, position: str) -> dict[str, str]:
    if kind == "electrical":
        return {"i": state}
    if kind == "storage":
        return {"h": state}
    return {"v": state, "x": position} if position else {"v": state}


_ACTS: Mapping[PortKind, str] = {"motion": "f", "storage": "q", "electrical": "v"}


def _units(s: Structure, kind: PortKind, signals: Mapping[str, str], unit: str) -> dict[str, str]:
    return {**{k: _unit_in(s, n) for k, n in signals.items()}, _ACTS[kind]: unit}


# balances that the model's own class states


def _equation(
    s: Structure, state: str, position: str, values: Mapping[str, float], units: Mapping[str, str]
) -> Port | None:
    flow = {v.name for v in s.flat.variables if v.flow}
    for index, driver in _drivers(s, state):
        e = s.flat.equations[index]
        names = names_in(e.left) | names_in(e.right)
        if e.component or e.origin not in ("component", "binding") or names & flow:
            continue
        entrance = entrance_of(s.flat, index, is_driver(driver), values, units)
        if entrance is None:
            continue
        own = _own_name(s, state)
        kind = _kind(s, state, position)
        signals = _signals(kind, own, _own_name(s, position) if position else "")
        states = tuple(dict.fromkeys((*s.states_in(e.left), *s.states_in(e.right), state)))
        return Port(
            own, kind, "equation", entrance.unit, _units(s, kind, signals, entrance.unit), e.place,
            tuple(_own_name(s, x) for x in states), signals, entrance,
        )  # fmt: skip
    return None


def driver_names(s: Structure, state: str) -> list[str]:
    """What a balance drives: the derivative of a state, or a variable that equals it."""
    rate = s.rates.get(s.of(state))
    names = [f"der({n})" for n in s.members(s.of(state))]
    return names + (s.members(rate) if rate is not None and rate not in s.states else [])


def is_driver(name: str) -> Driver:
    """Whether a term is a driver of that name."""

    def found(t: Term) -> bool:
        if name.startswith("der("):
            return t.kind == "call" and t.word == "der" and t.parts[0][1].word == name[4:-1]
        return t.kind == "name" and t.word == name

    return found


def _drivers(s: Structure, state: str) -> Iterator[tuple[int, str]]:
    """Equations that may be the balance of a state, with what they drive: its derivative, or a name for that."""
    wanted = driver_names(s, state)
    late: list[tuple[int, str]] = []
    for i, e in enumerate(s.flat.equations):
        for driver in wanted:
            if _contains(e, driver):
                # an equation that says only der(x) = rate is the balance where no other one has the rate
                if i in s.plain:
                    late.append((i, driver))
                elif driver.startswith("der(") or _gives(e, driver):
                    yield i, driver
    yield from late


def _gives(e: FlatEquation, name: str) -> bool:
    """Whether an equation can be the one that determines a name: it stands alone on a side, or in a product."""
    return any(isinstance(t, Name) and t.name == name for t in (e.left, e.right)) or any(
        isinstance(t, Call) and t.function in ("*", "/") and name in names_in(t) for t in (e.left, e.right)
    )


def _contains(e: FlatEquation, driver: str) -> bool:
    if not driver.startswith("der("):
        return driver in names_in(e.left) | names_in(e.right)
    return any(_has_der(t, driver[4:-1]) for t in (e.left, e.right))


def _has_der(tree: Expression, name: str) -> bool:
    if isinstance(tree, Call):
        if tree.function == "der":
            return isinstance(tree.args[0], Name) and tree.args[0].name == name
        return any(_has_der(a, name) for a in tree.args)
    return False


def _own_name(s: Structure, state: str) -> str:
    """The name of a state in the model's own class, where it has one there that is no output."""
    plain = [n for n in s.members(state) if "." not in n]
    inner = [n for n in plain if s.variables[n].causality == "local"]
    return state if "." not in state else next(iter(inner or plain), state)


# connections


def _sets(flat: FlatModel) -> Iterator[tuple[int, list[str]]]:
    """Sums of flows at connections of the model's own class, by the names of the flows."""
    flow = {v.name for v in flat.variables if v.flow}
    for i, e in enumerate(flat.equations):
        if e.origin == "flow":
            names = _sum_names(e.left)
            if names and all(n in flow and n.count(".") == 2 for n in names):
                yield i, names


def _sum_names(tree: Expression) -> list[str]:
    match tree:
        case Name(name, ()):
            return [name]
        case Call("+", (one, two)):
            return [*_sum_names(one), *_sum_names(two)]
    return []


def _potential(s: Structure, connector: str) -> str:
    """The one variable of a connector that is no flow, without the connector's name; empty where there are more."""
    inner = [n for n, v in s.variables.items() if n.startswith(connector + ".") and not v.flow]
    return inner[0].rpartition(".")[2] if len(inner) == 1 and inner[0].rpartition(".")[0] == connector else ""


def _node(s: Structure, state: str, position: str) -> Port | None:
    """A node whose potential is the state or its position; the one at the component that has the state comes first."""
    owner = state.rpartition(".")[0]
    choices: list[tuple[bool, int, list[str], str]] = []
    for i, flows in _sets(s.flat):
        connectors = [f.rpartition(".")[0] for f in flows]
        potential = _potential(s, connectors[0])
        cls = s.of(f"{connectors[0]}.{potential}")
        if potential and cls in (state, position):
            connectors.sort(key=lambda c: not c.startswith(owner + "."))
            choices.append((not connectors[0].startswith(owner + "."), i, connectors, potential))
    if not choices:
        return None
    _, index, connectors, potential = min(choices, key=lambda c: c[:2])
    flow = s.flat.equations[index]
    name = _sum_names(flow.left)[0].rpartition(".")[2]
    v = s.variables[f"{connectors[0]}.{name}"]
    kind = _kind(s, state, position)
    if kind == "electrical":
        return None
    signals = _signals(kind, state, position)
    return Port(
        connectors[0], kind, "node", v.unit, _units(s, kind, signals, v.unit), s.variables[state].place,
        (position, state) if position else (state,), signals, Entrance(index, Number(1.0), v.unit),
        tuple(connectors), name, potential,
    )  # fmt: skip


def _series(s: Structure, state: str) -> Port | None:
    """A connection of two connectors whose flow is the state, a current: a drop of potential may lie between them."""
    if not _is_current(s, state):
        return None
    owner = state.rpartition(".")[0] + "."
    pairs = [flows for _, flows in _sets(s.flat) if len(flows) == 2 and s.of(flows[0]) == state]
    for flows in sorted(pairs, key=lambda f: not any(n.startswith(owner) for n in f)):
        connectors = [f.rpartition(".")[0] for f in flows]
        potential, name = _potential(s, connectors[0]), flows[0].rpartition(".")[2]
        ends = {f"{c}.{potential}" for c in connectors}
        for i, e in enumerate(s.flat.equations):
            if e.origin == "connection" and names_in(e.left) | names_in(e.right) == ends and isinstance(e.left, Name):
                left = e.left.name.rpartition(".")[0]
                right = next(c for c in connectors if c != left)
                unit = s.variables[e.left.name].unit
                signals = {"i": f"{right}.{name}"}
                own = next((c for c in connectors if c.startswith(owner)), left)
                return Port(
                    own, "electrical", "series", unit, _units(s, "electrical", signals, unit),
                    s.variables[state].place, (state,), signals, Entrance(i, Number(-1.0), unit), (left, right), name,
                    potential,
                )  # fmt: skip
    return None


def _alike(one: str, other: str) -> bool:
    """Whether two units may be the same: a unit that nobody gave may be any."""
    return not one or not other or one == other


def _neighbours(port: Port, ports: Sequence[Port]) -> tuple[str, ...]:
    if port.kind != "storage":
        return ()
    others = [p for p in ports if p.kind == "storage" and p.id != port.id and p.via == port.via]
    others = [p for p in others if _alike(p.units["h"], port.units["h"]) and _alike(p.unit, port.unit)]
    others.sort(key=lambda p: port.states[-1:] != p.states[-1:] and not set(port.states) & set(p.states))
    return tuple(p.id for p in others)
