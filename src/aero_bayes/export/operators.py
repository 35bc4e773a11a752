"""Operators of Modelica that are more than functions of numbers: derivatives, ``pre``, and those that make events."""

from __future__ import annotations

from aero_bayes.export import arrays
from aero_bayes.export.arrays import Value, scalars
from aero_bayes.export.events import Events
from aero_bayes.export.expression import Builder, Node


class Operators:
    """Applies operators to values."""

    def __init__(self, builder: Builder, events: Events | None) -> None:
        self.builder = builder
        self.events = events
        self.derivatives: dict[str, Node] = {}
        self.left_limits: dict[Node, Node] = {}

    def relation(self, op: str, left: Value, right: Value) -> Value:
        """``left op right``, element by element; texts can be equal or not."""
        if isinstance(left, str) and isinstance(right, str) and op in ("eq", "ne"):
            return self.builder.const(float((left == right) is (op == "eq")))
        if self.events is None:
            return arrays.elementwise(lambda a, b: self.builder.binary(op, a, b), left, right)
        events = self.events
        return arrays.elementwise(lambda a, b: events.relation(op, a, b), left, right)

    def der(self, value: Value) -> Value:
        """Return the time derivative, by the chain rule down to the symbols ``der(x)``."""
        return arrays.mapped(self._rate, value)

    def _rate(self, node: Node) -> Node:
        b = self.builder
        if node.op == "symbol" and node.name != "time" and not self._is_piecewise_constant(node):
            derivative = b.symbol(f"der({node.name})")
            self.derivatives[node.name] = derivative
            return derivative
        result = b.zero
        for symbol in sorted(b.symbols(node), key=lambda s: s.index):
            slope = b.derivative(node, symbol)
            if symbol.name == "time":
                result = b.add(result, slope)
            elif slope is not b.zero and not self._is_piecewise_constant(symbol):
                result = b.add(result, b.mul(slope, self._rate(symbol)))
        return result

    def _is_piecewise_constant(self, symbol: Node) -> bool:
        return self.events is not None and symbol in self.events.piecewise_constant

    def pre(self, value: Value) -> Value:
        """Return the value until the event: of a discrete variable ``pre(x)``, of a continuous one its left limit."""
        return arrays.mapped(self._pre, value)

    def _pre(self, node: Node) -> Node:
        if node.name.startswith("pre("):
            return node  # in an algorithm, before it assigns the variable
        if self.events is not None and self.events.constant_between(node):
            return self.events.pre(node) if node.op == "symbol" else node
        if node.op == "symbol":
            limit = self.builder.symbol(f"left({node.name})")
            self.left_limits[limit] = node
            return limit
        raise LookupError("pre() of something that is not a variable")

    def change(self, value: Value) -> Value:
        """Return whether a discrete variable differs from its value until the event."""
        return arrays.elementwise(lambda x, y: self.builder.binary("ne", x, y), value, self.pre(value))

    def edge(self, value: Value) -> Value:
        """Return whether a Boolean variable becomes true in the event."""
        b = self.builder
        return arrays.elementwise(lambda x, y: b.binary("and", x, b.unary("not", y)), value, self.pre(value))

    def rounded(self, op: str, value: Value) -> Value:
        """``floor``, ``ceil`` or ``integer`` of numbers."""
        b = self.builder
        if op == "ceil":
            return arrays.mapped(lambda x: b.neg(self._floor(b.neg(x))), value)
        return arrays.mapped(self._floor, value)

    def _floor(self, x: Node) -> Node:
        return self.builder.unary("floor", x) if self.events is None else self.events.floor(x)

    def divided(self, op: str, left: Value, right: Value) -> Value:
        """``div``, ``mod`` or ``rem`` of numbers."""
        return arrays.elementwise(lambda x, y: self._divide(op, x, y), left, right)

    def _divide(self, op: str, x: Node, y: Node) -> Node:
        b = self.builder
        ratio = b.div(x, y)
        if op == "mod":
            return b.sub(x, b.mul(self._floor(ratio), y))
        sign = self.relation("ge", ratio, b.zero)
        down, up = self._floor(ratio), b.neg(self._floor(b.neg(ratio)))
        whole = b.select(sign, down, up) if isinstance(sign, Node) else down
        return whole if op == "div" else b.sub(x, b.mul(whole, y))

    def semi_linear(self, flow: Node, up: Value, down: Value) -> Value:
        """``flow`` times ``up`` where it is not negative, else times ``down``."""
        b = self.builder
        positive = scalars(self.relation("ge", flow, b.zero))[0]
        return arrays.elementwise(b.mul, arrays.select(b, positive, up, down), flow)
