"""Expressions as C statements."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

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


#: Functions that are worth a test of whether a factor is zero, and operations that stay finite where one gives zero.
_SLOW = frozenset(
    {"exp", "log", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "sqrt", "pow", "atan2"}
)
_FINITE = frozenset({"add", "sub", "neg", "mul", "abs", "min", "max", "tanh", "sin", "cos", "atan", "exp"})


class ExpressionWriter:
    """Prints expressions as C statements over local variables."""

    def __init__(self, leaves: dict[Node, str], factors: frozenset[Node] = frozenset()) -> None:
        self.leaves = leaves
        self.factors = factors
        self._factor_of: dict[Node, Node] = {}
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
        nodes = list(nodes)
        order = list(topological_order(nodes, done))
        if self.factors:
            self._factor_of = _common_factors(nodes, order, self.factors)
        for n in order:
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
            call = f"{FUNCTIONS[n.op]}({', '.join(args)})"
            return f"{self.leaves[self._factor_of[n]]} != 0.0 ? {call} : 0.0" if n in self._factor_of else call
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


def _common_factors(roots: Sequence[Node], order: Sequence[Node], factors: frozenset[Node]) -> dict[Node, Node]:
    """Return, for each slow function that counts only times some factor, one such factor."""
    always: dict[Node, frozenset[Node]] = dict.fromkeys(roots, frozenset())
    for n in reversed(order):
        here = always.get(n, frozenset())
        for k, a in enumerate(n.args):
            found: frozenset[Node] = frozenset()
            if n.op in _FINITE or (n.op == "div" and k == 0) or (n.op == "select" and k > 0):
                found = here | (factors & {n.args[1 - k]} if n.op == "mul" else frozenset())
            always[a] = always[a] & found if a in always else found
    return {n: min(always[n], key=lambda f: f.index) for n in order if n.op in _SLOW and always.get(n)}


def number(value: float) -> str:
    """Return a number as a C literal."""
    text = repr(value)
    return f"({text})" if value < 0 else text
