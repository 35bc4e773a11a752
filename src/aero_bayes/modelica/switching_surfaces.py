"""Surfaces on which a model may slide: where a relation changes its sign and drives the states straight back.

Dry friction as ``F_c * sign(v)`` or ``if v > 0 then F_c else -F_c`` is the usual case: at rest the acceleration points
down just above ``v = 0`` and up just below it. There the model follows the combination of both sides that stays on the
surface (A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, section 4), which
``native/sliding.h`` computes. Here it is found where that can happen at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from random import Random

from aero_bayes.modelica.causalisation import ExplicitModel
from aero_bayes.modelica.equation_system import ScalarVariable
from aero_bayes.modelica.expression import Builder, Node, evaluate_nodes, topological_order
from aero_bayes.modelica.graphs import reachable
from aero_bayes.modelica.linear_equations import AlgebraicLoop
from aero_bayes.modelica.operators import Relation
from aero_bayes.modelica.parse import without_indices


@dataclass(frozen=True)
class VariableLayout:
    """Which variable has which value reference: states, derivatives, inputs, parameters, dependent ones, outputs.

    ``names`` of states are those of the outputs that equal them where there are any; ``aliases`` maps further names."""

    states: tuple[ScalarVariable, ...]
    state_paths: tuple[str, ...]
    inputs: tuple[ScalarVariable, ...]
    parameters: tuple[ScalarVariable, ...]
    dependent: tuple[ScalarVariable, ...]
    outputs: tuple[ScalarVariable, ...]
    aliases: dict[str, int]

    @property
    def first_parameter(self) -> int:
        """Value reference of the first independent parameter."""
        return 2 * len(self.states) + len(self.inputs)

    @property
    def first_dependent(self) -> int:
        """Value reference of the first dependent parameter."""
        return self.first_parameter + len(self.parameters)

    @property
    def first_output(self) -> int:
        """Value reference of the first output that is no state."""
        return self.first_dependent + len(self.dependent)


def lay_out(model: ExplicitModel) -> VariableLayout:
    """Sort the variables that the FMU shows. Outputs that equal a state share its value reference."""
    b = model.system.builder
    by_name = {v.name: v for v in model.system.variables}
    top = [v for v in model.system.variables if v.shown]
    symbols = {b.symbol(path): i for i, path in enumerate(model.states)}
    position = {o.name: symbols[e] for o in top if (e := model.solved.get(o.name, b.symbol(o.name))) in symbols}
    aliases: dict[str, int] = {}
    states: list[ScalarVariable] = []
    for i, path in enumerate(model.states):
        inner = by_name[path]
        mine = [o for o in top if position.get(o.name) == i]
        if mine:
            first = next((o for o in mine if o.name == path), mine[0])
            aliases.update({v.name: i for v in (inner, *mine) if v.name != first.name})
            inner = replace(
                first,
                description=first.description or inner.description,
                unit=first.unit or inner.unit,
                attributes={**inner.attributes, **{k: v for k, v in first.attributes.items() if k != "start"}},
                fixed=inner.fixed,
            )
        states.append(inner)
    expressions = (*model.rates, *(model.solved.get(o.name, b.zero) for o in top), *model.starts)
    used = frozenset[Node]().union(*(b.symbols(e) for e in (*expressions, *model.loop_and_event_expressions)))
    # of an array whose elements are used in part all are shown: Modelica sets an array as a whole
    used_arrays = {without_indices(s.name) for s in used}
    free, dependent = [], []
    for p in model.system.parameters:
        if p.type != "Real" or p.final or p.variability == "constant" or p.binding is None:
            continue
        if p.binding.op == "const":
            if "." not in p.name or without_indices(p.name) in used_arrays:
                free.append(p)
        elif "." not in p.name:
            dependent.append(p)
    outputs = [o for o in (*top, *(v for v in model.system.discrete_variables if v.shown)) if o.name not in position]
    return VariableLayout(
        tuple(states), model.states, model.system.inputs, tuple(free), tuple(dependent), tuple(outputs), aliases
    )


_RAW = frozenset({"sign", "lt", "le", "gt", "ge"})
#: Two sides that differ by less than this share at all of a few points are the same function.
_SAME = 1e-9
_POINTS = 3


@dataclass(frozen=True)
class Surface:
    """Where ``difference`` is zero."""

    difference: Node
    relations: tuple[tuple[int, bool], ...]
    rise: Node


@dataclass(frozen=True)
class SwitchingModel:
    """An explicit model, the surfaces on which it may slide, and the symbols of its states' derivatives there.

    ``instant`` has the discrete variables that follow from the relations of the same instant alone."""

    model: ExplicitModel
    surfaces: tuple[Surface, ...]
    rates: tuple[Node, ...]
    instant: frozenset[Node]


def find_surfaces(model: ExplicitModel) -> SwitchingModel:
    """Find the surfaces of a model; ``sign`` and relations without events become relations with events there.

    A surface is a difference of states, parameters and time whose slope changes with the relations of its own sign.
    Differences of inputs are none: how fast an input moves is not known to an FMU."""
    b = model.system.builder
    rates = tuple(b.symbol(f"rate#{i}") for i in range(len(model.states)))
    search = _Search(model)
    places: dict[Node, list[tuple[int, bool]]] = {}
    for i, r in enumerate(model.discrete.relations):
        if model.time_of_change(r.difference) is None:
            key, same = _oriented(b, r.difference)
            places.setdefault(key, []).append((i, same is not r.below))
    raw: dict[Node, list[Node]] = {}
    for n in search.raw_nodes():
        raw.setdefault(_oriented(b, _difference(b, n))[0], []).append(n)
    relations = list(model.discrete.relations)
    memo: dict[Node, Node] = {}
    surfaces = []
    for key in {**places, **raw}:
        known, plain = places.get(key, []), raw.get(key, [])
        sides = {relations[i].symbol: (b.const(above), b.const(not above)) for i, above in known}
        sides |= {n: _sides(b, n) for n in plain}
        if not search.may_slide(key, sides):
            continue
        members = _Members(b, key, relations, known)
        memo |= {n: members.expression(n) for n in plain}
        moving = {b.symbol(name): rate for name, rate in zip(model.states, rates, strict=True)}
        surfaces.append(Surface(key, tuple(members.places), search.slope(key, moving)))
    instant = frozenset(search.instant)
    if not surfaces:
        return SwitchingModel(model, (), rates, instant)
    model = replace(
        model,
        rates=tuple(b.substitute(r, memo) for r in model.rates),
        solved={n: b.substitute(e, memo) for n, e in model.solved.items()},
        loops=tuple(AlgebraicLoop(g.unknowns, tuple(b.substitute(r, memo) for r in g.residuals)) for g in model.loops),
        discrete=replace(
            model.discrete,
            updates={d: b.substitute(e, memo) for d, e in model.discrete.updates.items()},
            relations=tuple(relations),
        ),
    )
    return SwitchingModel(model, tuple(surfaces), rates, instant)


class _Members:
    """The relations that change on one surface, and new ones in place of ``sign`` and of relations without events."""

    def __init__(self, b: Builder, key: Node, relations: list[Relation], places: Iterable[tuple[int, bool]]) -> None:
        self.b = b
        self.key = key
        self.relations = relations
        self.places = list(places)

    def _symbol(self, above: bool) -> Node:
        """Return the symbol of the relation that holds where the difference is positive, or negative."""
        for i, holds in self.places:
            r = self.relations[i]
            if holds is above and r.difference is self.key and r.below is not above:
                return r.symbol
        place = len(self.relations)
        self.relations.append(Relation(self.b.symbol(f"relation#{place}"), self.key, not above))
        self.places.append((place, above))
        return self.relations[place].symbol

    def expression(self, n: Node) -> Node:
        """Return what stands in the place of ``sign(...)`` or of a relation without events."""
        b = self.b
        same = _oriented(b, _difference(b, n))[1]
        if n.op == "sign":
            return b.sub(self._symbol(same), self._symbol(not same))
        above = same if n.op in ("gt", "le") else not same
        symbol = self._symbol(above)
        return symbol if n.op in ("gt", "lt") else b.unary("not", symbol)


class _Search:
    """Asks whether the slope of a difference changes with its sign."""

    def __init__(self, model: ExplicitModel) -> None:
        self.model = model
        self.b = model.system.builder
        self.states = {self.b.symbol(n): r for n, r in zip(model.states, model.rates, strict=True)}
        self.known = set(self.states) | {self.b.symbol(p.name) for p in model.system.parameters} | {model.system.time}
        self.loop_of = {u: loop.residuals for loop in model.loops for u in loop.unknowns}
        self.instant = {d for d in model.discrete.updates if self._follows(d, frozenset())}

    def _follows(self, d: Node, above: frozenset[Node]) -> bool:
        """Return whether a discrete variable has no memory."""
        updates = self.model.discrete.updates
        for s in self.b.symbols(updates[d]):
            if s in above or s.name.startswith(("pre(", "sample#", "initial(", "when#", "left(")):
                return False
            if s in updates and not self._follows(s, above | {d}):
                return False
        return not d.name.startswith("when#")

    def raw_nodes(self) -> Iterator[Node]:
        """``sign`` and relations without events, of differences that can be surfaces."""
        roots = [*self.model.rates, *(r for loop in self.model.loops for r in loop.residuals)]
        roots += [self.model.discrete.updates[d] for d in self.instant]
        for n in topological_order(roots, {}):
            if n.op in _RAW and self._can_be_surface(_difference(self.b, n)):
                yield n

    def _can_be_surface(self, difference: Node) -> bool:
        symbols = self.b.symbols(difference)
        return symbols <= self.known and not symbols.isdisjoint(self.states)

    def slope(self, difference: Node, rates: Mapping[Node, Node]) -> Node:
        """Return the slope of a difference in time, with the derivatives of the states."""
        b = self.b
        slope = b.derivative(difference, self.model.system.time)
        for s in sorted(b.symbols(difference) & self.states.keys(), key=lambda s: s.index):
            slope = b.add(slope, b.mul(b.derivative(difference, s), rates[s]))
        return slope

    def may_slide(self, difference: Node, sides: Mapping[Node, tuple[Node, Node]]) -> bool:
        """Return whether the slope differs between both sides of a surface.

        ``sides`` has each relation's values there."""
        b = self.b
        if not self._can_be_surface(difference):
            return False
        slope = self.slope(difference, self.states)
        if self._through_symbols(slope, sides):
            return True
        above = b.substitute(slope, {n: v for n, (v, _) in sides.items()})
        below = b.substitute(slope, {n: v for n, (_, v) in sides.items()})
        return above is not below and not self._agree(_on_surface(b, difference, [above, below]))

    def _through_symbols(self, slope: Node, sides: Mapping[Node, tuple[Node, Node]]) -> bool:
        """Return whether it depends on the relations by the unknowns of loops or by discrete variables."""

        def deeper(s: Node) -> tuple[Node, ...]:
            return (self.model.discrete.updates[s],) if s in self.instant else self.loop_of.get(s, ())

        symbols = reachable(self.b.symbols(slope), lambda s: (n for e in deeper(s) for n in self.b.symbols(e)))
        return any(n in sides for n in topological_order([e for s in symbols for e in deeper(s)], {}))

    def _agree(self, both: list[Node]) -> bool:
        """Return whether two expressions have the same value at a few points."""
        if both[0] is both[1]:
            return True
        symbols = sorted(self.b.symbols(both[0]) | self.b.symbols(both[1]), key=lambda s: s.index)
        draw = Random(1)
        for _ in range(_POINTS):
            try:
                one, two = evaluate_nodes(both, {s: draw.uniform(0.5, 1.5) for s in symbols})
            except (ArithmeticError, ValueError):
                return False
            if not abs(one - two) <= _SAME * max(abs(one), abs(two)):
                return False
        return True


def _difference(b: Builder, n: Node) -> Node:
    return n.args[0] if n.op == "sign" else b.sub(*n.args)


def _sides(b: Builder, n: Node) -> tuple[Node, Node]:
    """Return the values of ``sign`` or of a relation where the difference of its surface is positive, and negative."""
    same = _oriented(b, _difference(b, n))[1]
    low = b.const(-1.0) if n.op == "sign" else b.zero
    values = (low, b.one) if n.op in ("lt", "le") else (b.one, low)
    return values if same else values[::-1]


def _oriented(b: Builder, difference: Node) -> tuple[Node, bool]:
    """Return one form of a difference and of its negative; whether it has the sign of the one that was given."""
    if difference.op == "neg":
        key, same = _oriented(b, difference.args[0])
        return key, not same
    if difference.op in ("mul", "div") and (constant := next((a for a in difference.args if a.op == "const"), None)):
        other = difference.args[1] if difference.args[0] is constant else difference.args[0]
        if constant.value != 0.0 and (difference.op == "mul" or difference.args[1] is constant):
            key, same = _oriented(b, other)
            return key, same is (constant.value > 0.0)
    if difference.op == "sub" and difference.args[0].index > difference.args[1].index:
        return b.sub(difference.args[1], difference.args[0]), False
    return difference, True


def _on_surface(b: Builder, difference: Node, expressions: Iterable[Node]) -> list[Node]:
    """Expressions where the difference is zero, as far as a symbol of it can be replaced by the rest."""
    memo: dict[Node, Node] = {}
    first, *rest = difference.args or (difference,)
    if difference.op == "symbol":
        memo = {difference: b.zero}
    elif difference.op in ("sub", "add"):
        other = rest[0] if difference.op == "sub" else b.neg(rest[0])
        if first.op == "symbol" and first not in b.symbols(other):
            memo = {first: other}
        elif rest[0].op == "symbol" and rest[0] not in b.symbols(first):
            memo = {rest[0]: first if difference.op == "sub" else b.neg(first)}
    return [b.substitute(e, memo) for e in expressions]
