"""Finds the ports of a model: its inputs and outputs, its balances, its connections."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from aero_bayes.errors import InputError
from aero_bayes.laws.aliases import AliasStructure, alias_structure, derived_names, is_derivative
from aero_bayes.laws.balance import (
    LOAD,
    Balance,
    Port,
    PortKind,
    Signal,
    find_balance,
    parameter_values,
    signal_port,
)
from aero_bayes.laws.insertion_point import Driver
from aero_bayes.laws.internal_signals import ambient_differences, connected_inputs, internal_signals
from aero_bayes.laws.relative_motion import (
    SPEEDS,
    branch_ports,
    force_outputs,
    is_current,
    is_load,
    is_prescribed,
    is_relative_motion,
    kind_of,
    node_port,
    owner_of,
    relative_motions,
    series_port,
    signals_of,
    storage_pin_port,
    unit_in,
    units_of,
)
from aero_bayes.modelica.causalisation import causalise
from aero_bayes.modelica.compose import add_output
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.modelica.graphs import assign, reachable
from aero_bayes.modelica.syntax import Call, Expression, Name, children, names_in, parse_reference, short_text
from aero_bayes.modelica.units import dimension_of_unit


def find_ports(flat: FlatModel) -> list[Port]:
    """Return all ports of a model: inputs, outputs, then balances in the order of their states.

    The port of a state is at a balance or a connection in the model's own class. If there is none, it is at the balance
    inside a component. An output that is a force and depends on a speed is a balance as well."""
    s = alias_structure(flat)
    rated = _rated(flat, [v.name for v in s.flat.variables if _top(v, "output")])
    balances = list(_balances(s, flat))
    balances += branch_ports(s, balances)
    nodes = {p.id for p in balances if p.attachment == "node"}
    balances = [replace(p, id=f"series_{p.id}") if p.attachment == "series" and p.id in nodes else p for p in balances]
    forces = list(force_outputs(s, {p.balance.equation for p in balances if p.balance is not None}))
    taken = {p.id for p in (*balances, *forces)}
    outputs = [replace(p, id=f"output_{p.id}") if p.id in taken else p for p in _outputs(s, rated)]
    ports = [*_inputs(s), *outputs, *balances, *forces]
    ports = [replace(p, neighbours=_neighbours(p, ports)) for p in ports]
    return [
        *ports, *internal_signals(s, flat), *connected_inputs(s, flat), *relative_motions(s, balances),
        *ambient_differences(s, balances),
    ]  # fmt: skip


def _top(v: FlatVariable, causality: str) -> bool:
    return v.causality == causality and "." not in v.name and v.type == "Real" and not v.sizes and not v.constant


def _inputs(s: AliasStructure) -> Iterator[Port]:
    for v in s.flat.variables:
        if _top(v, "input"):
            yield signal_port("input", "input", v.name, v.unit, v.place)


def _outputs(s: AliasStructure, rated: Collection[str]) -> Iterator[Port]:
    for v in s.flat.variables:
        if _top(v, "output"):
            own = s.of(v.name)
            giving = [e for e in s.flat.equations if isinstance(e.left, Name) and e.left.name == v.name]
            states = (own,) if own in s.states else tuple(x for e in giving for x in s.states_in(e.right))
            kind: PortKind = "output" if v.name in rated else "reading"
            yield signal_port(kind, "output", v.name, v.unit, v.place, states=states)


def _rated(flat: FlatModel, outputs: Sequence[str]) -> set[str]:
    """Return outputs whose derivative can be computed. It cannot for an output with direct feedthrough of an input."""
    wider = flat
    for n, name in enumerate(outputs):
        wider = add_output(wider, f"rate_of_output_{n}", Call("der", (parse_reference(name),)))
    try:
        causalise(translate(wider))
    except InputError:
        return {name for one in outputs for name in _rated(flat, [one])} if len(outputs) > 1 else set()
    return set(outputs)


def _balances(s: AliasStructure, flat: FlatModel) -> Iterator[Port]:
    positions = {x: r for x, r in s.rates.items() if r in s.states}
    driven = [x for x in s.states if x not in positions or is_current(s, positions[x])]
    driven = [x for x in driven if not is_prescribed(s, x) and not _again(s, x, positions)]
    own, inner = (_assigned(s, flat, driven, inside=inside) for inside in (False, True))
    for state in driven:
        known, owner = [x for x, r in positions.items() if r == state], owner_of(s, state)
        position = next((x for x in known if owner_of(s, x) == owner), next(iter(known), ""))
        found = (
            series_port(s, state)
            or _equation(s, state, position, own.get(state))
            or node_port(s, state, position)
            or _equation(s, state, position, inner.get(state))
        )
        if found is not None:
            yield found
            drop = storage_pin_port(s, state) if found.kind == "storage" else None
            if drop is not None:
                yield drop


# balance equations


#: An equation that may be the balance of a state, by its index among those of the structure.
_BalanceOption = tuple[int, Balance]


def _assigned(s: AliasStructure, flat: FlatModel, states: Sequence[str], *, inside: bool) -> dict[str, _BalanceOption]:
    """Return a balance for each state, by maximum bipartite matching of states and equations (augmenting paths).

    Equations are those of the model's own class, or with ``inside`` those of its components. With coupled masses, an
    equation contains several derivatives. It is preferred for a state whose derivative has a constant factor."""
    values = parameter_values(s.flat)
    units = {v.name: v.unit for v in s.flat.variables}
    flow = {v.name for v in s.flat.variables if v.flow}
    options: dict[str, list[_BalanceOption]] = {}
    places = _rows_of(s, states)
    for state in states:
        found: list[tuple[bool, bool, _BalanceOption]] = []
        for index, driver in _drivers(s, state):
            e = s.flat.equations[index]
            names = names_in(e.left) | names_in(e.right)
            stated = bool(e.component) is inside and e.origin in ("component", "binding")
            kinematic = _kinematic(s, state, names) or (inside and index in s.plain)
            if inside and is_relative_motion(s, state):
                kinematic = index in s.plain or not _other_than_speeds(s, names)
            if not stated or kinematic or (names & flow and not inside):
                continue
            equation, row, of = s.origins[index]
            within = (flat, equation) if row else (s.flat, index)
            balance = find_balance(*within, is_driver(driver, whole=row > 0), values, units, (row, of) if row else None)
            if balance is not None:
                away = row > 0 and places.get((equation, state)) != row
                option = index, replace(balance, equation=equation, state=state)
                found.append((away, not _constant_factor(s, e, driver), option))
        options[state] = [option for *_, option in sorted(found, key=lambda f: f[:2])]
    taken = assign([[index for index, _ in options[x]] for x in states])
    return {states[k]: next(o for o in options[states[k]] if o[0] == index) for index, k in taken.items()}


def _rows_of(s: AliasStructure, states: Sequence[str]) -> dict[tuple[int, str], int]:
    """Return the preferred row of each state in a vector equation.

    The first row for the first of its states, and so on."""
    found: dict[tuple[int, str], int] = {}
    for equation in {index for index, row, _ in s.origins if row}:
        whole = {n for e, o in zip(s.flat.equations, s.origins, strict=True) if o[0] == equation for n in _driving(e)}
        own = [x for x in states if whole & {*driver_names(s, x)}]
        found |= {(equation, x): row for row, x in enumerate(own, 1)}
    return found


def _driving(e: FlatEquation) -> set[str]:
    """Return the names in an equation, and its derivatives as ``der(x)``."""
    sides = e.left, e.right
    return {n for side in sides for n in (*names_in(side), *(f"der({x})" for x in derived_names(side)))}


def _again(s: AliasStructure, state: str, positions: Collection[str]) -> bool:
    """Return whether a relative motion has a balance already, or is an earlier relative motion again."""
    if not is_relative_motion(s, state):
        return False
    if s.moving[state][0] in {s.moving[x][0] for x in positions}:
        return True
    earlier = [x for x in s.states[: s.states.index(state)] if is_relative_motion(s, x)]
    return any(s.apart.get(x, x) == s.apart.get(state, state) for x in earlier)


def _other_than_speeds(s: AliasStructure, names: set[str]) -> bool:
    varying = [n for n in names if n in s.variables and not s.variables[n].constant]
    return any(dimension_of_unit(unit_in(s, s.of(n))) not in SPEEDS for n in varying)


def _kinematic(s: AliasStructure, state: str, names: set[str]) -> bool:
    """Return whether an equation only integrates a speed to an angle or a displacement."""
    unit = unit_in(s, state)
    varying = {s.of(n) for n in names if n in s.variables and not s.variables[n].constant} - {state}
    speeds = all(dimension_of_unit(unit_in(s, n)) in SPEEDS for n in varying)
    return unit == "rad" or (unit == "m" and bool(varying) and speeds)


def _constant_factor(s: AliasStructure, e: FlatEquation, driver: str) -> bool:
    """Return whether all factors of a derivative in an equation are constants."""

    def factors(tree: Expression) -> set[str]:
        if isinstance(tree, Call) and tree.function in ("+", "-", "neg"):
            return next((factors(a) for a in tree.args if _holds(a, driver)), set())
        return names_in(tree) - {driver, driver[4:-1]}

    side = e.left if _holds(e.left, driver) else e.right
    return all(s.variables[n].constant for n in factors(side) if n in s.variables)


def _equation(s: AliasStructure, state: str, position: str, option: _BalanceOption | None) -> Port | None:
    if option is None:
        return None
    e, balance = s.flat.equations[option[0]], option[1]
    own = _own_name(s, state)
    kind = kind_of(s, state, position)
    signals = signals_of(kind, own, _own_name(s, position) if position else "")
    if is_relative_motion(s, state):
        kind, signals = "motion", {"x": Signal.of(own), "v": Signal.of(s.rates[state])}
    units = units_of(s, kind, signals, balance.unit)
    if kind == "motion" and balance.load is not None and is_load(s, balance.load, signals.values()):
        signals, units = {**signals, LOAD: balance.load}, {**units, LOAD: balance.unit}
    states = tuple(dict.fromkeys((*s.states_in(e.left), *s.states_in(e.right), state)))
    return Port(
        own, kind, "equation", balance.unit, units, e.place,
        tuple(_own_name(s, x) for x in states), signals, balance,
        counts=kind == "storage" and not _depends_on_level(s, e, state),
    )  # fmt: skip


def _depends_on_level(s: AliasStructure, e: FlatEquation, state: str) -> bool:
    """Return whether the derivative of a state in an equation may depend on the state, also through other equations."""
    given = {*s.states, *(s.of(n) for n, v in s.variables.items() if v.causality == "input" or v.constant)}
    others = [_outside_derivatives(s, o) for o in s.flat.equations if o is not e]

    def beside(name: str) -> Iterator[str]:
        """Yield what stands in an equation with a variable, unless it is given."""
        return (n for names in others if name in names for n in names if name not in given)

    return state in reachable(_outside_derivatives(s, e), beside)


def _outside_derivatives(s: AliasStructure, e: FlatEquation) -> set[str]:
    """Return classes of the variables in an equation, but for those of which only the derivative occurs."""
    found, waiting = set[str](), [e.left, e.right]
    while waiting:
        tree = waiting.pop()
        if is_derivative(tree) is None:
            found |= {s.of(tree.name)} if isinstance(tree, Name) else set()
            waiting += children(tree)
    return found


def driver_names(s: AliasStructure, state: str) -> list[str]:
    """Return names of the derivative of a state: ``der(x)``, and variables that equal it."""
    rate = s.rates.get(s.of(state))
    names = [f"der({n})" for n in s.members(s.of(state))]
    return names + (s.members(rate) if rate is not None and rate not in s.states else [])


def is_driver(name: str, *, whole: bool = False) -> Driver:
    """Return a test whether an expression is the derivative of that name.

    With ``whole``, also the array that has it."""

    def same(word: str, name: str) -> bool:
        return word == name or (whole and word.partition("[")[0] == name.partition("[")[0])

    def found(t: Expression) -> bool:
        match t:
            case Name():
                return same(short_text(t), name)
            case Call("der", (Name() as inner,)):
                return name.startswith("der(") and same(short_text(inner), name[4:-1])
        return False

    return found


def _drivers(s: AliasStructure, state: str) -> Iterator[tuple[int, str]]:
    """Yield equations that may be the balance of a state, with the name of its derivative there."""
    wanted = driver_names(s, state)
    late: list[tuple[int, str]] = []
    for i, e in enumerate(s.flat.equations):
        for driver in wanted:
            if _holds(e.left, driver) or _holds(e.right, driver):
                # der(x) = rate is the balance only if no other equation contains the rate
                if i in s.plain:
                    late.append((i, driver))
                elif driver.startswith("der(") or is_relative_motion(s, state) or _gives(e, driver):
                    yield i, driver
    yield from late


def _gives(e: FlatEquation, name: str) -> bool:
    """Return whether an equation can determine a variable: it is a whole side, or a factor of a product."""
    return any(isinstance(t, Name) and t.name == name for t in (e.left, e.right)) or any(
        isinstance(t, Call) and t.function in ("*", "/") and name in names_in(t) for t in (e.left, e.right)
    )


def _holds(tree: Expression, driver: str) -> bool:
    return driver[4:-1] in derived_names(tree) if driver.startswith("der(") else driver in names_in(tree)


def _own_name(s: AliasStructure, state: str) -> str:
    """Return the name of a state in the model's own class, if it has one that is no output."""
    return next((n for n in s.members(state) if "." not in n and s.variables[n].causality == "local"), state)


def _alike(one: str, other: str) -> bool:
    """Return whether two units may be equal. An unknown unit may be any unit."""
    return not one or not other or one == other


def _neighbours(port: Port, ports: Sequence[Port]) -> tuple[str, ...]:
    if port.kind != "storage":
        return ()
    others = [p for p in ports if p.kind == "storage" and p.id != port.id and p.attachment == port.attachment]
    others = [p for p in others if _alike(p.units["h"], port.units["h"]) and _alike(p.unit, port.unit)]
    others.sort(
        key=lambda p: (
            p.signals["h"].first not in port.states and port.signals["h"].first not in p.states,
            port.states[-1:] != p.states[-1:] and not set(port.states) & set(p.states),
        )
    )
    return tuple(p.id for p in others)
