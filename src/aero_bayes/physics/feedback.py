"""Signals inside a model: of a controller, from one part of a model to the next, from block to block."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from aero_bayes.export.flat import FlatEquation, FlatModel
from aero_bayes.export.syntax import Name, names_in
from aero_bayes.physics.ports import Port
from aero_bayes.physics.structure import Structure, derived_in, is_derivative


def feedback(s: Structure, flat: FlatModel) -> Iterator[Port]:
    """A port for every signal that the model's own class gives from a state and an input, such as a controller's.

    One that is given from states alone, or is a state by another name, is a signal where nothing comes back from what
    it acts on: one filter's to the next. It acts as an input does: what follows reads what a law makes of it.
    """
    given = _given(s, flat)
    inputs = {s.of(v.name) for v in flat.variables if v.causality == "input" and "." not in v.name}
    onward = _onward(s, given)
    for name, index in given.items():
        e = flat.equations[index]
        reached = _reached(s, name, given)
        acts = any(_acts(s, o, name) for o in flat.equations if o is not e)
        within = reached & {*s.states}
        if within and acts and (reached & inputs or not within & _following(_told(s, name, given), onward)):
            unit = flat.variable(name).unit
            states = tuple(x for x in s.states if x in reached)
            yield Port(name, "input", "signal", unit, {"u": unit, "y": unit}, e.place, states, {"u": name}, given=index)


def connected(s: Structure, flat: FlatModel) -> Iterator[Port]:
    """A port for every input of a component that the model's own class connects to another component's output."""
    for index, e in enumerate(flat.equations):
        match e.left, e.right:
            case Name(one, ()), Name(two, ()) if e.origin == "connection" and not e.component:
                for inner, outer in ((one, two), (two, one)):
                    if _passed(s, inner, "input") and _passed(s, outer, "output"):
                        unit = s.variables[inner].unit or s.variables[outer].unit
                        states = tuple(s.states_in(Name(outer)))
                        signals = {"u": unit, "y": unit}
                        yield Port(
                            inner, "input", "signal", unit, signals, e.place, states, {"u": inner}, given=index
                        )  # fmt: skip


def _onward(s: Structure, given: Collection[str]) -> dict[str, set[str]]:
    """What each variable acts on at once."""
    found: dict[str, set[str]] = {}
    for e in s.flat.equations:
        for name in _variables(s, e):
            found.setdefault(name, set()).update(_heads(s, e, given))
    return found


def _variables(s: Structure, e: FlatEquation) -> set[str]:
    return {s.of(n) for n in (names_in(e.left) | names_in(e.right)) if n in s.same}


def _heads(s: Structure, e: FlatEquation, given: Collection[str]) -> set[str]:
    """What an equation gives; where it does not say, all that is in it."""
    rates = {rate: state for state, rate in s.rates.items() if rate not in s.states}
    names = _variables(s, e)
    heads = {s.of(x) for x in derived_in(e)} & {*s.states} or {rates[n] for n in names if n in rates}
    if isinstance(e.left, Name) and e.left.name in given:
        heads = {s.of(e.left.name)}
    return heads if len(heads) == 1 else names


def _told(s: Structure, name: str, given: Mapping[str, int]) -> set[str]:
    """What equations give that have a signal in them by its own name, but for the one that gives it."""
    every = zip(s.flat.equations, s.origins, strict=True)
    others = (e for e, (index, *_) in every if index != given[name] and name in names_in(e.left) | names_in(e.right))
    return {head for e in others for head in _heads(s, e, given)}


def _following(begin: Collection[str], onward: Mapping[str, set[str]]) -> set[str]:
    """Some variables and all that they act on, by whatever way."""
    found, waiting = {*begin}, [*begin]
    while waiting:
        new = onward.get(waiting.pop(), set()) - found
        found |= new
        waiting += new
    return found


def _passed(s: Structure, name: str, causality: str) -> bool:
    """Whether a variable is a component's own input or output."""
    v = s.variables.get(name)
    return v is not None and v.causality == causality and name.count(".") == 1 and v.type == "Real" and not v.sizes


def giving(flat: FlatModel, port: Port) -> list[int]:
    """The equations that give a signal, before any law: one, or where it is connected all that connections say."""
    if port.given is None:
        return []
    if flat.equations[port.given].origin != "connection":
        return [port.given]
    return [i for i, e in enumerate(flat.equations) if e.origin == "connection"]


def _acts(s: Structure, e: FlatEquation, name: str) -> bool:
    """Whether an equation makes something of a signal: it is no mere name for a rate, and nothing that is only read."""
    for one, other in ((e.left, e.right), (e.right, e.left)):
        if other == Name(name) and is_derivative(one):
            return False
        if isinstance(one, Name) and s.variables[one.name].causality == "output" and "." not in one.name:
            return False
    return name in names_in(e.left) | names_in(e.right)


def _gives(e: FlatEquation, name: str) -> bool:
    return e.left == Name(name) and not e.component and e.origin in ("component", "binding") and not derived_in(e)


def _given(s: Structure, flat: FlatModel) -> dict[str, int]:
    """Local variables that one equation gives, with its index: a value of their own, or that of a state."""
    local = {
        v.name for v in flat.variables
        if v.causality == "local" and "." not in v.name and v.type == "Real" and not v.sizes and not v.constant
        and not _derived(s, v.name) and (s.of(v.name) in s.states or len(s.members(s.of(v.name))) == 1)
    }  # fmt: skip
    found: dict[str, list[int]] = {}
    for index, e in enumerate(flat.equations):
        if isinstance(e.left, Name) and e.left.name in local and _gives(e, e.left.name):
            found.setdefault(e.left.name, []).append(index)
    return {name: indices[0] for name, indices in found.items() if len(indices) == 1}


def _derived(s: Structure, name: str) -> bool:
    return any(name in derived_in(e) for e in s.flat.equations)


def _reached(s: Structure, name: str, given: Mapping[str, int]) -> set[str]:
    """What a signal is computed from, by way of others that are; of an array its elements."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        index = given[waiting.pop()]
        own = (e.right for e, (of, *_) in zip(s.flat.equations, s.origins, strict=True) if of == index)
        names = {n for tree in own for n in names_in(tree) if n in s.same}
        waiting += [n for n in names if n in given and s.of(n) not in found]
        found |= {s.of(n) for n in names}
    return found
