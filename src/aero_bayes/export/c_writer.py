"""Expressions as C statements."""

from __future__ import annotations

from collections.abc import Iterable

from aero_bayes.export.expression import Node, topological_order

FUNCTIONS = {
    "sqrt": "sqrt", "exp": "exp", "log": "log", "log10": "log10", "sin": "sin", "cos": "cos", "tan": "tan",
    "asin": "asin", "acos": "acos", "atan": "atan", "sinh": "sinh", "cosh": "cosh", "tanh": "tanh", "abs": "fabs",
    "pow": "pow", "atan2": "atan2", "floor": "floor",
}  # fmt: skip
INFIX = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==",
    "ne": "!=", "and": "&&", "or": "||",
}  # fmt: skip


class ExpressionWriter:
    """Prints expressions as C statements over local variables."""

    def __init__(self, leaves: dict[Node, str]) -> None:
        self.leaves = leaves
        self.lines: list[str] = []
        self.known: dict[Node, str] = {}

    def term(self, node: Node) -> str:
        """Return the C text of an expression that is a leaf, a constant or was written before."""
        if node in self.leaves:
            return self.leaves[node]
        if node.op == "const":
            return number(node.value)
        return self.known[node]

    def write(self, nodes: Iterable[Node]) -> None:
        """Append one statement for each operation that the expressions need and that was not written before."""
        done: dict[Node, object] = {**self.known, **self.leaves}
        for n in topological_order(list(nodes), done):
            if n.op == "const":
                continue
            if n.op == "symbol":
                raise KeyError(n.name)
            self.known[n] = f"t{n.index}"
            self.lines.append(self.declaration(n))

    def declaration(self, node: Node) -> str:
        """Return the statement that computes one operation."""
        return f"    const double t{node.index} = {self._expression(node)};"

    def _expression(self, n: Node) -> str:
        args = [self.term(a) for a in n.args]
        if n.op in INFIX:
            return f"{args[0]} {INFIX[n.op]} {args[1]}"
        if n.op in FUNCTIONS:
            return f"{FUNCTIONS[n.op]}({', '.join(args)})"
        match n.op:
            case "neg":
                return f"-{args[0]}"
            case "not":
                return f"!{args[0]}"
            case "sign":
                return f"({args[0]} > 0) - ({args[0]} < 0)"
            case "select":
                return f"{args[0]} ? {args[1]} : {args[2]}"
            case "min":
                return f"{args[0]} < {args[1]} ? {args[0]} : {args[1]}"
            case "max":
                return f"{args[0]} > {args[1]} ? {args[0]} : {args[1]}"
        raise NotImplementedError(n.op)


def number(value: float) -> str:
    """Return a number as a C literal."""
    text = repr(value)
    return f"({text})" if value < 0 else text
