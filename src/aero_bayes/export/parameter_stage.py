"""Which expressions depend on parameters alone, so that they are computed once and not at every time step."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.export.expression import Builder, Node, topological_order


class ParameterStage:
    """Tells expressions of parameters alone from the rest, and turns division by one into multiplication."""

    def __init__(self, builder: Builder, parameters: frozenset[Node]) -> None:
        self.builder = builder
        self.parameters = parameters
        self._memo: dict[Node, Node] = {}

    def of_parameters_only(self, node: Node) -> bool:
        """Return whether an expression depends on parameters alone."""
        return self.builder.symbols(node) <= self.parameters

    def reciprocal(self, node: Node) -> Node:
        """Return the expression with divisions by early expressions as multiplications by their reciprocals."""
        b = self.builder
        for n in topological_order([node], self._memo):
            args = tuple(self._memo[a] for a in n.args)
            if n.op == "div" and self.of_parameters_only(args[1]) and not self.of_parameters_only(args[0]):
                self._memo[n] = b.mul(args[0], b.div(b.one, args[1]))
            else:
                self._memo[n] = b.apply(n, args) if n.args else n
        return self._memo[node]

    def to_store(self, nodes: Sequence[Node]) -> list[Node]:
        """Early expressions (no plain symbols or constants) that late ones or the results use directly."""
        found: dict[Node, None] = {}

        def consider(n: Node) -> None:
            if n.args and self.of_parameters_only(n):
                found.setdefault(n)

        for n in nodes:
            consider(n)
        for n in topological_order(nodes, {}, lambda n: not self.of_parameters_only(n)):
            if not self.of_parameters_only(n):
                for a in n.args:
                    consider(a)
        return sorted(found, key=lambda n: n.index)
