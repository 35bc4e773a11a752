"""Ports at signals inside a model, such as outputs of a controller, and at differences of a state and an input."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from aero_bayes.laws.aliases import AliasStructure, derived_in, derived_names, is_derivative
from aero_bayes.laws.balance import KELVIN, Port, Signal, signal_port
from aero_bayes.laws.relative_motion import all_differences, balance_of, differences_in, unit_in
from aero_bayes.modelica.flat import FlatEquation, FlatModel
from aero_bayes.modelica.graphs import reachable
from aero_bayes.modelica.syntax import Expression, Name, children, names_in

#: Index of an equation in the model, the variables in it, and the alias classes that it determines.
Determined = tuple[int, set[str], set[str]]


def internal_signals(s: AliasStructure, flat: FlatModel) -> Iterator[Port]:
    """Yield ports at variables that an explicit equation computes from states and inputs, as in a controller.

    A variable that is computed from states alone is a signal only without feedback: if its states do not depend on it,
    as from one filter to the next. A law at a signal acts as at an input: the rest of the model reads its output."""
    given = _explicit_variables(s, flat)
    inputs = {s.of(v.name) for v in flat.variables if v.causality == "input" and "." not in v.name}
    told = _determined(s, given)
    onward, read = _dependents(s, told), _read(s)
    for name, index in given.items():
        e = flat.equations[index]
        computed = reachable(read[given[name]], lambda n: read[given[n]] if n in given else ())
        reached = {s.of(n) for n in computed}
        acts = any(_acts(s, o, name) for o in flat.equations if o is not e)
        within = reached & {*s.states}
        first = {head for of, names, heads in told if of != index and name in names for head in heads}
        if within and acts and (reached & inputs or not within & reachable(first, lambda x: onward.get(x, ())).keys()):
            states, unit = tuple(x for x in s.states if x in reached), flat.variable(name).unit
            yield signal_port("input", "signal", name, unit, e.place, states=states, defining_equation=index)


def connected_inputs(s: AliasStructure, flat: FlatModel) -> Iterator[Port]:
    """Yield ports at inputs of components that the model's own class connects to outputs of other components."""
    for index, e in enumerate(flat.equations):
        match e.left, e.right:
            case Name(one, ()), Name(two, ()) if e.origin == "connection" and not e.component:
                for inner, outer in ((one, two), (two, one)):
                    if _is_component_signal(s, inner, "input") and _is_component_signal(s, outer, "output"):
                        unit = s.variables[inner].unit or s.variables[outer].unit
                        states = tuple(s.states_in(Name(outer)))
                        yield signal_port(
                            "input", "signal", inner, unit, e.place, states=states, defining_equation=index
                        )


def _determined(s: AliasStructure, given: Collection[str]) -> list[Determined]:
    """Return, for each equation its index, its variables, and the variables that it determines.

    All of them if implicit."""
    rates = {rate: state for state, rate in s.rates.items() if rate not in s.states}
    found: list[Determined] = []
    for e, (index, *_) in zip(s.flat.equations, s.origins, strict=True):
        names = {n for n in names_in(e.left) | names_in(e.right) if n in s.same}
        classes = {s.of(n) for n in names}
        heads = {s.of(x) for x in derived_in(e)} & {*s.states} or {rates[n] for n in classes if n in rates}
        if isinstance(e.left, Name) and e.left.name in given:
            heads = {s.of(e.left.name)}
        found.append((index, names, heads if len(heads) == 1 else classes))
    return found


def _dependents(s: AliasStructure, told: Sequence[Determined]) -> dict[str, set[str]]:
    """Return, by alias class, the classes that it acts on directly."""
    found: dict[str, set[str]] = {}
    for _, names, heads in told:
        for name in names:
            found.setdefault(s.of(name), set()).update(heads)
    return found


def _is_component_signal(s: AliasStructure, name: str, causality: str) -> bool:
    """Return whether a variable is a scalar input or output of a component."""
    v = s.variables.get(name)
    return v is not None and v.causality == causality and name.count(".") == 1 and v.type == "Real" and not v.sizes


def defining_equations(flat: FlatModel, port: Port) -> list[int]:
    """List the equations that define a signal: its own one, or all connection equations if it is connected."""
    if port.defining_equation is None:
        return []
    if flat.equations[port.defining_equation].origin != "connection":
        return [port.defining_equation]
    return [i for i, e in enumerate(flat.equations) if e.origin == "connection"]


def _acts(s: AliasStructure, e: FlatEquation, name: str) -> bool:
    """Return whether a signal acts in an equation: not if that only names a derivative, or defines an output."""
    for one, other in ((e.left, e.right), (e.right, e.left)):
        if other == Name(name) and is_derivative(one):
            return False
        if isinstance(one, Name) and s.variables[one.name].causality == "output" and "." not in one.name:
            return False
    return name in names_in(e.left) | names_in(e.right)


def _explicit_variables(s: AliasStructure, flat: FlatModel) -> dict[str, int]:
    """Return local variables that exactly one explicit equation defines, with the index of that equation."""
    derived = {n for e in s.flat.equations for n in derived_in(e)}
    local = {
        v.name for v in flat.variables
        if v.causality == "local" and "." not in v.name and v.type == "Real" and not v.sizes and not v.constant
        and v.name not in derived and (s.of(v.name) in s.states or len(s.members(s.of(v.name))) == 1)
    }  # fmt: skip
    found: dict[str, list[int]] = {}
    for index, e in enumerate(flat.equations):
        own = not e.component and e.origin in ("component", "binding") and not derived_in(e)
        if own and isinstance(e.left, Name) and e.left.name in local and not e.left.subscripts:
            found.setdefault(e.left.name, []).append(index)
    return {name: indices[0] for name, indices in found.items() if len(indices) == 1}


def _read(s: AliasStructure) -> dict[int, set[str]]:
    """Return the variables on the right-hand side of each equation of the model; elements of arrays."""
    found: dict[int, set[str]] = {}
    for e, (index, *_) in zip(s.flat.equations, s.origins, strict=True):
        found.setdefault(index, set()).update(n for n in names_in(e.right) if n in s.same)
    return found


def ambient_differences(s: AliasStructure, balances: Sequence[Port]) -> Iterator[Port]:
    """Yield ports at differences of a state and an input.

    There is a port where the difference occurs in an equation, and for each storage of heat with each temperature that
    is an input. An input that is the ambient level of one storage is so for all storages of the same unit."""
    fed = _input_classes(s)
    apart = all_differences(s)
    levels = {s.of(p.signals["h"].first): p.units["h"] for p in balances if p.kind == "storage"}
    around = {(cls, unit) for level, unit in levels.items() for cls in fed if frozenset((level, cls)) in apart}
    for port in balances:
        if port.kind == "storage" and port.attachment in ("equation", "node"):
            unit = port.units["h"]
            for cls, name in fed.items():
                if (unit in KELVIN and unit_in(s, cls) == unit) or (cls, unit) in around:
                    yield replace(
                        port, id=f"{port.id}-{name}", signals={**port.signals, "h_s": Signal.of(name)}, neighbours=(),
                    )  # fmt: skip
        elif port.kind == "motion" and port.attachment == "equation":
            acting = _acting(s, port)
            other = {
                signal: next((name for cls, name in fed.items() if frozenset((s.of(str(own)), cls)) in acting), "")
                for signal, own in port.signals.items()
            }
            signals = {n: Signal.of(str(port.signals[n]), name) for n, name in other.items() if name}
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
