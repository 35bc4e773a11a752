"""The discrete part of a model: what when clauses, discrete equations and algorithms assign, and when."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from aero_bayes.errors import InputError
from aero_bayes.modelica import array_values
from aero_bayes.modelica.array_values import Value, scalars
from aero_bayes.modelica.expression import Builder, Node
from aero_bayes.modelica.flat import FlatModel, When
from aero_bayes.modelica.graphs import assign
from aero_bayes.modelica.operators import Events, PeriodicEvent, Relation, Rounding
from aero_bayes.modelica.scope import Scope
from aero_bayes.modelica.syntax import (
    Assign,
    Expression,
    IfStatement,
    Name,
    ReinitStatement,
    Statement,
    UnsupportedStatement,
    WhenStatement,
)


@dataclass(frozen=True)
class Reinit:
    """``state`` becomes ``value`` in an event in which ``active`` holds."""

    state: Node
    active: Node
    value: Node


@dataclass(frozen=True)
class DiscretePart:
    """What changes in events only."""

    updates: dict[Node, Node]
    reinits: tuple[Reinit, ...] = ()
    relations: tuple[Relation, ...] = ()
    roundings: tuple[Rounding, ...] = ()
    samplings: tuple[PeriodicEvent, ...] = ()
    assertions: tuple[tuple[Node, str], ...] = ()
    before: Mapping[Node, Node] = field(default_factory=dict)
    limits: Mapping[Node, Node] = field(default_factory=dict)


def assigned_in_events(model: FlatModel) -> set[str]:
    """Return names that some when clause assigns."""
    found = set[str]()

    def search(body: Iterable[Statement], inside: bool) -> None:
        for s in body:
            if isinstance(s, Assign) and inside:
                found.update(t.name for t in s.targets if t is not None)
            elif isinstance(s, WhenStatement):
                for _, inner in s.branches:
                    search(inner, True)
            elif isinstance(s, IfStatement):
                for inner in (*(b for _, b in s.branches), s.otherwise):
                    search(inner, inside)

    search((w.statement for w in model.whens), False)
    for algorithm in model.algorithms:
        search(algorithm.statements, False)
    return found


class EventActions:
    """Translates when clauses and algorithms into updates of discrete symbols and new values of states."""

    def __init__(self, scope: Scope, events: Events) -> None:
        self.scope = scope
        self.events = events
        self.updates: dict[Node, Node] = {}
        self.reinits: list[Reinit] = []
        self.conditions = 0

    def assign(self, symbol: Node, value: Node) -> None:
        """Give a discrete variable its value in an event. Raises InputError where it has one already."""
        if symbol in self.updates:
            raise self.scope.fail(f"{symbol.name!r}, which is assigned in two places")
        self.updates[symbol] = value

    def edge(self, condition: Expression) -> Node:
        """True in the event in which the condition (or one of several) becomes true."""
        b = self.scope.builder
        active = b.zero
        for c in scalars(self.scope.value(condition)):
            symbol = self.events.new(f"when#{self.conditions}")
            self.conditions += 1
            self.updates[symbol] = c
            active = b.binary("or", active, b.binary("and", symbol, b.unary("not", self.events.pre(symbol))))
        return active

    def branches(self, s: WhenStatement) -> Iterator[tuple[Node, tuple[Statement, ...]]]:
        """Yield each branch, and when it is the one that is executed."""
        b = self.scope.builder
        taken = b.zero
        for condition, body in s.branches:
            edge = self.edge(condition)
            active = b.binary("and", edge, b.unary("not", taken))
            taken = b.binary("or", taken, edge)
            yield active, body

    def clause(self, when: When) -> None:
        """Add a when equation with its elsewhen branches."""
        b = self.scope.builder
        self.scope.place = when.place
        values: dict[Node, Node] = {}
        for active, body in self.branches(when.statement):
            for s in body:
                match s:
                    case UnsupportedStatement(what):
                        raise self.scope.fail(what)
                    case Assign((Name() as name,), tree) | ReinitStatement(name, tree):
                        targets = scalars(self.scope.value(name))
                        new = _like(self.scope.value(tree), len(targets))
                    case _:
                        continue
                if isinstance(s, ReinitStatement):
                    self.reinits += [Reinit(state, active, x) for state, x in zip(targets, new, strict=True)]
                    continue
                for target, x in zip(targets, new, strict=True):
                    values[target] = b.select(active, x, values.get(target, self.events.pre(target)))
        for target, value in values.items():
            self.assign(target, value)

    def algorithm(self, statements: Sequence[Statement], outputs: Sequence[str]) -> list[tuple[Node, Node]]:
        """Runs an algorithm; gives the pairs (variable, value) of outputs that are not discrete."""
        found = []
        for s, new in self.run(statements, outputs):
            if s in self.events.piecewise_constant:
                self.assign(s, new)
            else:
                found.append((s, new))
        return found

    def run(self, statements: Sequence[Statement], outputs: Sequence[str]) -> list[tuple[Node, Node]]:
        """Return the variables that an algorithm assigns, and their values after it."""
        scope = self.scope
        saved = scope.values
        symbols = {n: saved[n] for n in outputs}
        scope.values = dict(saved)
        for n, value in symbols.items():
            scope.values[n] = array_values.mapped(
                lambda s: self.events.pre(s) if s in self.events.piecewise_constant else scope.builder.zero, value
            )
        self.statements(statements)
        found = [p for n, value in symbols.items() for p in array_values.pairs(value, scope.values[n])]
        scope.values = saved
        return found

    def statements(self, body: Sequence[Statement]) -> None:
        """Execute the statements of an algorithm, when statements among them."""
        scope = self.scope
        for s in body:
            if isinstance(s, WhenStatement):
                self.when_statement(s)
            elif isinstance(s, ReinitStatement):
                raise scope.fail("reinit() outside of a when clause")
            else:
                scope.run((s,))

    def when_statement(self, s: WhenStatement) -> None:
        """Execute a when statement of an algorithm with its elsewhen branches."""
        scope, b = self.scope, self.scope.builder
        for active, body in self.branches(s):
            before = dict(scope.values)
            for inner in body:
                if isinstance(inner, ReinitStatement):
                    state = scope.scalar(inner.state)
                    self.reinits.append(Reinit(state, active, scope.scalar(inner.value)))
                else:
                    scope.run((inner,))
            for n, value in scope.values.items():
                if n in before and value is not before[n]:
                    scope.values[n] = array_values.select(b, active, value, before[n])


def _like(value: Value, count: int) -> list[Node]:
    found = scalars(value)
    return found * count if len(found) == 1 else found


def match_discrete(
    scope: Scope, pairs: Sequence[tuple[Node, Node]], actions: EventActions, symbols: Sequence[Node]
) -> list[tuple[Node, Node]]:
    """Give each discrete equation ``left = right`` the variable that it determines (one of its sides).

    Equations that determine none of them are given back: they determine something continuous."""
    free = [s for s in symbols if s not in actions.updates]
    owner = assign([[s for s in pair if s in free] for pair in pairs])
    rest = [pair for k, pair in enumerate(pairs) if k not in owner.values()]
    for s, k in owner.items():
        left, right = pairs[k]
        actions.assign(s, right if s is left else left)
    for s in free:
        if s not in owner:
            raise scope.fail(f"the discrete variable {s.name!r}, which no equation determines")
    return rest


def solve_discrete(
    model: str, b: Builder, part: DiscretePart, solved: Mapping[Node, Node], states: set[Node]
) -> DiscretePart:
    """Return the discrete part in terms of states, and each discrete value without the others."""
    # until the event the discrete variables were what they were; states are so still
    old = {d: b.symbol(f"pre({d.name})") for d in part.updates}
    solved = {**solved, **{limit: b.substitute(solved.get(v, v), dict(old)) for limit, v in part.limits.items()}}
    first = {d: b.substitute(e, dict(solved)) for d, e in part.updates.items()}
    done: dict[Node, Node] = {}

    def settle(d: Node, above: tuple[Node, ...]) -> None:
        if d in done:
            return
        if d in above:
            names = ", ".join(s.name for s in above[above.index(d) :])
            raise InputError(f"model {model}: the discrete variables {names} depend on each other in one instant")
        needed = sorted((s for s in b.symbols(first[d]) if s in first), key=lambda s: s.index)
        for s in needed:
            settle(s, (*above, d))
        done[d] = b.substitute(first[d], {s: done[s] for s in needed})

    for d in first:
        settle(d, ())
    memo = dict(solved)
    reinits = []
    for r in part.reinits:
        state = b.substitute(r.state, memo)
        value = b.substitute(r.value, memo)
        if state.op == "neg":
            state, value = state.args[0], b.neg(value)
        if state not in states:
            raise InputError(f"model {model}: reinit({r.state.name}) of a variable that is no state")
        reinits.append(Reinit(state, b.substitute(r.active, memo), value))
    return DiscretePart(
        {d: done[d] for d in first},
        tuple(reinits),
        tuple(replace(r, difference=b.substitute(r.difference, memo)) for r in part.relations),
        tuple(replace(r, argument=b.substitute(r.argument, memo)) for r in part.roundings),
        part.samplings,
        tuple((b.substitute(c, memo), message) for c, message in part.assertions),
        {s: b.substitute(e, memo) for s, e in part.before.items()},
    )
