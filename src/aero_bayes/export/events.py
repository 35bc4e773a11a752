"""What makes events: relations, rounding, sampling; each becomes a symbol that is constant between events."""

from __future__ import annotations

from dataclasses import dataclass, field

from aero_bayes.export.expression import Builder, Node

_STRICT = {"lt": "lt", "ge": "lt", "gt": "gt", "le": "gt"}


@dataclass(frozen=True)
class Relation:
    """``symbol`` is 1 where ``difference`` is below zero (``below``) or above it."""

    symbol: Node
    difference: Node
    below: bool


@dataclass(frozen=True)
class Rounding:
    """``symbol`` is the floor of ``argument``."""

    symbol: Node
    argument: Node


@dataclass(frozen=True)
class PeriodicEvent:
    """``symbol`` is 1 in the events at ``start + k interval``, k = 0, 1, ..."""

    symbol: Node
    start: Node
    interval: Node


@dataclass
class Events:
    """Collects events while a model is translated; the symbols ``piecewise_constant`` change in events only."""

    builder: Builder
    piecewise_constant: set[Node] = field(default_factory=set)
    relations: dict[tuple[Node, bool], Relation] = field(default_factory=dict)
    roundings: dict[Node, Rounding] = field(default_factory=dict)
    samplings: dict[tuple[Node, Node], PeriodicEvent] = field(default_factory=dict)

    def constant_between(self, node: Node) -> bool:
        """Return whether an expression changes in events only."""
        return self.builder.symbols(node) <= self.piecewise_constant

    def new(self, name: str) -> Node:
        """Return a new symbol that changes in events only."""
        symbol = self.builder.symbol(name)
        self.piecewise_constant.add(symbol)
        return symbol

    def relation(self, op: str, left: Node, right: Node) -> Node:
        """Return the truth of ``left op right``, which changes in events only."""
        b = self.builder
        plain = b.binary(op, left, right)
        if op in ("eq", "ne") or self.constant_between(plain):
            return plain
        strict = _STRICT[op]
        key = (b.sub(left, right), strict == "lt")
        if key not in self.relations:
            self.relations[key] = Relation(self.new(f"relation#{len(self.relations)}"), *key)
        symbol = self.relations[key].symbol
        return symbol if op == strict else b.unary("not", symbol)

    def floor(self, argument: Node) -> Node:
        """Return the floor of an expression, which changes in events only."""
        if self.constant_between(argument):
            return self.builder.unary("floor", argument)
        if argument not in self.roundings:
            self.roundings[argument] = Rounding(self.new(f"floor#{len(self.roundings)}"), argument)
        return self.roundings[argument].symbol

    def sample(self, start: Node, interval: Node) -> Node:
        """Return the symbol of ``sample(start, interval)``; both in s."""
        key = (start, interval)
        if key not in self.samplings:
            self.samplings[key] = PeriodicEvent(self.new(f"sample#{len(self.samplings)}"), start, interval)
        return self.samplings[key].symbol

    def pre(self, variable: Node) -> Node:
        """Return the symbol of a discrete variable's value until the event."""
        return self.new(f"pre({variable.name})")

    @property
    def initial(self) -> Node:
        """The symbol that is 1 in the initial event only."""
        return self.new("initial()")
