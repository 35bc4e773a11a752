"""Expressions as C statements."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping

from aero_bayes.modelica.parse import BINARY, BOOLEAN, UNARY


class Node:
    """One expression: a constant, a symbol, or an operation on other nodes. Compared by identity."""

    __slots__ = ("args", "index", "name", "op", "value")

    def __init__(self, index: int, op: str, args: tuple[Node, ...], value: float, name: str) -> None:
        self.index = index
        self.op = op
        self.args = args
        self.value = value
        self.name = name

    def __repr__(self) -> str:
        if self.op == "const":
            return repr(self.value)
        if self.op == "symbol":
            return self.name
        return f"{self.op}({', '.join(map(repr, self.args))})"


class Builder:
    """Makes nodes; equal expressions give the same node."""

    def __init__(self) -> None:
        self._table: dict[tuple[object, ...], Node] = {}
        self._symbols: dict[Node, frozenset[Node]] = {}
        self.zero = self.const(0.0)
        self.one = self.const(1.0)

    def _intern(self, op: str, args: tuple[Node, ...] = (), value: float = 0.0, name: str = "") -> Node:
        key = (op, *(a.index for a in args), value, name)
        node = self._table.get(key)
        if node is None:
            node = Node(len(self._table), op, args, value, name)
            self._table[key] = node
        return node

    def const(self, value: float) -> Node:
        """Return a number."""
        return self._intern("const", value=float(value) + 0.0)  # + 0.0: one zero, not two

    def symbol(self, name: str) -> Node:
        """Return a symbol; the same node for the same name."""
        return self._intern("symbol", name=name)

    def unary(self, op: str, a: Node) -> Node:
        """``op(a)`` with ``op`` in :data:`UNARY`. Raises ValueError or OverflowError for a constant out of range."""
        if a.op == "const":
            return self.const(UNARY[op](a.value))
        if op == "not" and a.op == "not":
            return a.args[0]
        if op == "neg":
            if a.op == "neg":
                return a.args[0]
            if a.op == "sub":
                return self.binary("sub", a.args[1], a.args[0])
        return self._intern(op, (a,))

    def binary(self, op: str, a: Node, b: Node) -> Node:
        """``op(a, b)`` with ``op`` in :data:`BINARY`. Raises ArithmeticError for constants out of range."""
        if a.op == "const" and b.op == "const":
            return self.const(BINARY[op](a.value, b.value))
        simpler = getattr(self, f"_{op}", None)
        if simpler is not None:
            found: Node | None = simpler(a, b)
            if found is not None:
                return found
        if op in ("add", "mul") and a.index > b.index:
            a, b = b, a
        return self._intern(op, (a, b))

    def _add(self, a: Node, b: Node) -> Node | None:
        if a is self.zero:
            return b
        if b is self.zero:
            return a
        if b.op == "neg":
            return self.sub(a, b.args[0])
        if a.op == "neg":
            return self.sub(b, a.args[0])
        return None

    def _sub(self, a: Node, b: Node) -> Node | None:
        if b is self.zero:
            return a
        if a is b:
            return self.zero
        if a is self.zero:
            return self.neg(b)
        if b.op == "neg":
            return self.add(a, b.args[0])
        if a.op == "neg":
            return self.neg(self.add(a.args[0], b))
        return None

    def _mul(self, a: Node, b: Node) -> Node | None:
        for x, y in ((a, b), (b, a)):
            if x.op == "const":
                if x.value == 0.0:
                    return self.zero
                if x.value == 1.0:
                    return y
                if x.value == -1.0:
                    return self.neg(y)
            if x.op == "neg":
                return self.neg(self.mul(x.args[0], y))
        return None

    def _div(self, a: Node, b: Node) -> Node | None:
        if a is self.zero:
            return a
        if b.op == "const" and abs(b.value) == 1.0:
            return a if b.value > 0 else self.neg(a)
        if a is b:
            return self.one
        if a.op == "neg":
            return self.neg(self.div(a.args[0], b))
        if b.op == "neg":
            return self.neg(self.div(a, b.args[0]))
        return None

    def _pow(self, a: Node, b: Node) -> Node | None:
        if b.op == "const":
            if b.value == 0.0:
                return self.one
            if b.value == 0.5:
                return self.unary("sqrt", a)
            if b.value.is_integer() and 1 <= b.value <= 8:
                half = self._pow(a, self.const(b.value // 2)) if b.value > 1 else self.one
                square = self.mul(half, half) if half is not None else self.one
                return self.mul(square, a) if b.value % 2 else square
        return None

    def _and(self, a: Node, b: Node) -> Node | None:
        for x, y in ((a, b), (b, a)):
            if x.op == "const":
                return y if x.value else x
        return a if a is b else None

    def _or(self, a: Node, b: Node) -> Node | None:
        for x, y in ((a, b), (b, a)):
            if x.op == "const":
                return self.one if x.value else y
        return a if a is b else None

    def add(self, a: Node, b: Node) -> Node:
        """``a + b``."""
        return self.binary("add", a, b)

    def sub(self, a: Node, b: Node) -> Node:
        """``a - b``."""
        return self.binary("sub", a, b)

    def mul(self, a: Node, b: Node) -> Node:
        """``a * b``."""
        return self.binary("mul", a, b)

    def div(self, a: Node, b: Node) -> Node:
        """``a / b``."""
        return self.binary("div", a, b)

    def neg(self, a: Node) -> Node:
        """``-a``."""
        return self.unary("neg", a)

    def select(self, condition: Node, a: Node, b: Node) -> Node:
        """``a`` where the condition holds, else ``b``; the branch not taken never enters the result."""
        if condition.op == "const":
            return a if condition.value else b
        if a is b:
            return a
        return self._intern("select", (condition, a, b))

    def apply(self, node: Node, args: tuple[Node, ...]) -> Node:
        """Return the operation of ``node`` on other arguments."""
        if node.op == "select":
            return self.select(*args)
        if len(args) == 1:
            return self.unary(node.op, args[0])
        return self.binary(node.op, args[0], args[1])

    def symbols(self, node: Node) -> frozenset[Node]:
        """Return the symbols that an expression contains."""
        for n in topological_order([node], self._symbols):
            if n.op == "symbol":
                self._symbols[n] = frozenset((n,))
            else:
                self._symbols[n] = frozenset().union(*(self._symbols[a] for a in n.args))
        return self._symbols[node]

    def substitute(self, node: Node, memo: dict[Node, Node]) -> Node:
        """Replace nodes by ``memo`` throughout; ``memo`` also caches, and gains every node that was visited."""
        for n in topological_order([node], memo):
            memo[n] = n if not n.args else self.apply(n, tuple(memo[a] for a in n.args))
        return memo[node]

    def derivative(self, node: Node, by: Node, memo: dict[Node, Node] | None = None) -> Node:
        """Partial derivative by the symbol ``by``; a ``memo`` may be shared between calls with the same symbol."""
        memo = {} if memo is None else memo
        memo[by] = self.one
        for n in topological_order([node], memo, lambda n: by in self.symbols(n)):
            memo[n] = self._chain(n, tuple(memo[a] for a in n.args)) if by in self.symbols(n) else self.zero
        return memo[node]

    def _chain(self, n: Node, d: tuple[Node, ...]) -> Node:
        if n.op in BOOLEAN or n.op in ("sign", "floor"):
            return self.zero
        if n.op == "select":
            return self.select(n.args[0], d[1], d[2])
        if len(d) == 1:
            return self._chain_unary(n, n.args[0], d[0])
        a, b = n.args
        da, db = d
        if n.op in ("add", "sub"):
            return self.binary(n.op, da, db)
        if n.op == "mul":
            return self.add(self.mul(da, b), self.mul(a, db))
        if n.op == "div":
            return self.div(self.sub(da, self.mul(n, db)), b)
        if n.op in ("min", "max"):
            return self.select(self.binary("le" if n.op == "min" else "ge", a, b), da, db)
        if n.op == "atan2":
            square = self.add(self.mul(a, a), self.mul(b, b))
            return self.div(self.sub(self.mul(da, b), self.mul(a, db)), square)
        result = self.mul(self.mul(b, self.binary("pow", a, self.sub(b, self.one))), da)
        if db is not self.zero:
            # a^b with a = 0 has no logarithm, but its derivative by b is zero for b > 0
            grow = self.mul(self.mul(n, self.unary("log", a)), db)
            result = self.add(result, self.select(self.binary("gt", a, self.zero), grow, self.zero))
        return result

    def _chain_unary(self, n: Node, a: Node, da: Node) -> Node:
        if da is self.zero:
            return da
        one = self.one
        match n.op:
            case "neg":
                return self.neg(da)
            case "sqrt":
                # where a root ends, as that of max(h, 0) does, what is in it does not change
                steep = self.div(self.mul(self.const(0.5), da), n)
                return self.select(self.binary("gt", n, self.zero), steep, self.zero)
            case "exp":
                slope = n
            case "log":
                return self.div(da, a)
            case "log10":
                return self.div(da, self.mul(self.const(math.log(10.0)), a))
            case "sin":
                slope = self.unary("cos", a)
            case "cos":
                slope = self.neg(self.unary("sin", a))
            case "tan":
                slope = self.add(one, self.mul(n, n))
            case "asin" | "acos":
                slope = self.div(one, self.unary("sqrt", self.sub(one, self.mul(a, a))))
                slope = slope if n.op == "asin" else self.neg(slope)
            case "atan":
                return self.div(da, self.add(one, self.mul(a, a)))
            case "sinh":
                slope = self.unary("cosh", a)
            case "cosh":
                slope = self.unary("sinh", a)
            case "tanh":
                slope = self.sub(one, self.mul(n, n))
            case "abs":
                return self.select(self.binary("ge", a, self.zero), da, self.neg(da))
            case _:
                raise NotImplementedError(n.op)
        return self.mul(slope, da)


def topological_order(
    roots: Iterable[Node], done: Mapping[Node, object], enter: Callable[[Node], bool] | None = None
) -> Iterable[Node]:
    """Nodes below ``roots`` that are not in ``done``, arguments first; below a node that ``enter`` refuses nothing."""
    seen: set[Node] = set()
    order: list[Node] = []
    stack = [(n, False) for n in reversed(list(roots))]
    while stack:
        node, ready = stack.pop()
        if ready:
            order.append(node)
        elif node not in seen and node not in done:
            seen.add(node)
            stack.append((node, True))
            if enter is None or enter(node):
                stack.extend((a, False) for a in reversed(node.args))
    return order


def evaluate_nodes(nodes: Iterable[Node], values: Mapping[Node, float]) -> list[float]:
    """Numbers of expressions at given values of their symbols."""
    nodes = list(nodes)
    known: dict[Node, float] = dict(values)

    def branch(n: Node) -> bool:
        return n.op != "select"

    for n in topological_order(nodes, known, branch):
        _evaluate_one(n, known)
    return [known[n] for n in nodes]


def _evaluate_one(n: Node, known: dict[Node, float]) -> None:
    if n.op == "const":
        known[n] = n.value
    elif n.op == "symbol":
        raise KeyError(n.name)
    elif n.op == "select":
        condition = evaluate_nodes([n.args[0]], known)[0]
        known[n] = evaluate_nodes([n.args[1] if condition else n.args[2]], known)[0]
    elif len(n.args) == 1:
        known[n] = UNARY[n.op](known[n.args[0]])
    else:
        known[n] = BINARY[n.op](known[n.args[0]], known[n.args[1]])


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

    def __init__(self, leaves: dict[Node, str], nodes: Iterable[Node] = ()) -> None:
        self.leaves = leaves
        self.lines: list[str] = []
        self.known: dict[Node, str] = {}
        self.write(nodes)

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
