"""Names, equations and statements of a model or function, evaluated to expression graphs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

from aero_bayes.modelica import array_values
from aero_bayes.modelica.array_values import Record, ShapeError, Value
from aero_bayes.modelica.evaluation import Evaluator
from aero_bayes.modelica.expression import Builder, Node, topological_order
from aero_bayes.modelica.flat import FlatEquation, Function
from aero_bayes.modelica.operators import with_search_from_first_row
from aero_bayes.modelica.syntax import (
    AssertStatement,
    Assign,
    Call,
    Expression,
    ForStatement,
    IfStatement,
    Name,
    Statement,
    UnsupportedStatement,
    WhileStatement,
    WholeDimension,
    map_children,
    summands,
)

SOLVE_FUNCTION = "Modelica.Math.Matrices.solve"


def without_solve(e: FlatEquation) -> FlatEquation:
    """Return the equation times the matrix that the library's ``solve`` inverts in it, where it stands in a sum.

    The library calls LAPACK; here the equations are solved as all others are."""
    matrix = _matrix(e.left) or _matrix(e.right)
    return e if matrix is None else replace(e, left=_times(matrix, e.left), right=_times(matrix, e.right))


def _matrix(tree: Expression) -> Expression | None:
    """``A`` of a ``solve(A, b)`` among the terms of a sum."""
    return next((m for _, t in summands(tree) for m in [_inverted(t)[0]] if m is not None), None)


def _inverted(tree: Expression) -> tuple[Expression | None, Expression]:
    """``A`` and ``b`` of ``solve(A, b)``; no matrix where a tree is no such call."""
    match tree:
        case Call(function, (matrix, right)) if function == SOLVE_FUNCTION:
            return matrix, right
    return None, tree


def _times(matrix: Expression, tree: Expression) -> Expression:
    if isinstance(tree, Call) and tree.function in ("+", "-", ".+", ".-", "neg"):
        return map_children(tree, lambda t: _times(matrix, t))
    inverted, right = _inverted(tree)
    return right if inverted == matrix else Call("*", (matrix, tree))


LIMIT = 256


def possible_values(b: Builder, node: Node) -> frozenset[float] | None:
    """Return every value that ``node`` can take, and maybe more; None where these are not a few numbers."""
    known: dict[Node, frozenset[float] | None] = {}
    for n in topological_order([node], known):
        known[n] = _of(b, n, known)
    return known[node]


def _of(b: Builder, n: Node, known: dict[Node, frozenset[float] | None]) -> frozenset[float] | None:
    if n.op == "const":
        return frozenset((n.value,))
    args = [known[a] for a in n.args]
    if n.op == "select":
        then, otherwise = args[1:]
        return None if then is None or otherwise is None else then | otherwise
    if n.op in ("and", "or") and (sure := frozenset((float(n.op == "or"),))) in args:
        return sure
    found: set[float] = set()
    sets = [a for a in args if a is not None]
    if not sets or len(sets) < len(args):
        return None
    for values in product(*sets):
        if len(found) >= LIMIT:
            return None
        result = b.apply(n, tuple(map(b.const, values)))
        if result.op != "const":
            return None
        found.add(result.value)
    return frozenset(found)


MAX_TURNS = 1000
MAX_DEPTH = 50  # of functions that call functions


class Scope(Evaluator):
    """Evaluates equations, algorithms and calls of functions, see :class:`Evaluator`.

    Branches that are not decided yet are both executed and merged: each variable gets a choice between its two values.
    Loops are unrolled."""

    depth = 0

    def sides(self, equations: Sequence[FlatEquation]) -> list[tuple[Node, Node]]:
        """Left and right side of each equation, number by number."""
        found: list[tuple[Node, Node]] = []
        for equation in map(without_solve, equations):
            self.place = equation.place
            left, right = self.value(equation.left), self.value(equation.right)
            try:
                found += array_values.pairs(left, right)
            except ShapeError as error:
                raise self.fail(f"{error} in one equation") from None
        self.place = None
        return found

    def call_function(self, function: Function, args: tuple[Expression, ...]) -> Value:
        """Return the result of a function of the model: its body is executed on the arguments."""
        if self.depth > MAX_DEPTH:
            raise self.fail(f"the recursive function {function.name!r}")
        if len(args) > len(function.inputs):
            raise self.fail(f"function {function.name!r} called with {len(args)} arguments")
        inner = Scope(self.builder, self.functions, {}, f"function {function.name}", records=self.records)
        inner.depth = self.depth + 1
        for a, tree in zip(function.inputs, with_search_from_first_row(function.name, args), strict=False):
            inner.values[a.name] = self.value(tree)
        for a in function.inputs[len(args) :]:
            if a.default is None:
                raise self.fail(f"function {function.name!r} called without {a.name!r}")
            inner.values[a.name] = inner.value(a.default)
        if function.constructor:
            return Record([a.name for a in function.inputs], [inner.values[a.name] for a in function.inputs])
        if function.external:
            raise self.fail(f"the external function {function.name!r}")
        for a in (*function.outputs, *function.locals):
            if a.default is not None:
                inner.values[a.name] = inner.value(a.default)
            elif a.sizes and not any(isinstance(s, WholeDimension) for s in a.sizes):
                inner.values[a.name] = array_values.filled(self.builder.zero, [inner.integer(s) for s in a.sizes])
            elif a.type in self.records:
                inner.values[a.name] = Record(self.records[a.type], [self.builder.zero] * len(self.records[a.type]))
        inner.run(function.body)
        results = []
        for a in function.outputs:
            if a.name not in inner.values:
                raise self.fail(f"function {function.name!r}, which does not assign its result {a.name!r}")
            results.append(inner.values[a.name])
        return results[0] if len(results) == 1 else results

    def run(self, body: Sequence[Statement]) -> None:
        """Execute statements in order, each assignment on the values of those before it."""
        for statement in body:
            match statement:
                case Assign(targets, value):
                    result = self.value(value)
                    if len(targets) == 1:
                        self._assign(targets[0], result)
                        continue
                    if not isinstance(result, list):
                        result = [result]
                    for target, item in zip(targets, result, strict=False):
                        self._assign(target, item)
                case ForStatement(variable, values, inner):
                    for _ in self._each(variable, values):
                        self.run(inner)
                case WhileStatement(condition, inner):
                    self._while(condition, inner)
                case IfStatement(branches, otherwise):
                    self._branch(branches, otherwise)
                case AssertStatement():
                    pass  # a check of the arguments, not a part of the result
                case UnsupportedStatement(what):
                    raise self.fail(what)
                case _:
                    raise self.fail(f"{type(statement).__name__.removesuffix('Statement').lower()!r} in an algorithm")

    def _assign(self, target: Name | None, value: Value) -> None:
        if target is None:
            return
        if target.subscripts and target.name not in self.values:
            raise self.fail(f"the assignment to an element of {target.name!r}")
        self.assign(target.name, [self.integer(s) for s in target.subscripts], value)

    def _branch(
        self, branches: Sequence[tuple[Expression, tuple[Statement, ...]]], otherwise: Sequence[Statement]
    ) -> None:
        if not branches:
            self.run(otherwise)
            return
        condition = self.scalar(branches[0][0])
        if condition.op == "const":
            if condition.value:
                self.run(branches[0][1])
            else:
                self._branch(branches[1:], otherwise)
            return
        before = dict(self.values)
        self.run(branches[0][1])
        then = self.values
        self.values = before
        self._branch(branches[1:], otherwise)
        self.values = self._merged(condition, then, self.values)

    def _while(self, condition: Expression, body: Sequence[Statement]) -> None:
        """Turn by turn, each under its condition, until the condition is known to fail."""
        turns = []
        for _ in range(MAX_TURNS):
            going = self.scalar(condition)
            if possible_values(self.builder, going) == frozenset((0.0,)):
                break
            if going.op != "const":
                turns.append((going, self.values))
                self.values = dict(self.values)
            self.run(body)
        else:
            raise self.fail(f"a while loop that no constant ends within {MAX_TURNS} turns; write it as a for loop")
        for going, before in reversed(turns):
            self.values = self._merged(going, self.values, before)

    def _merged(self, condition: Node, then: Mapping[str, Value], otherwise: Mapping[str, Value]) -> dict[str, Value]:
        merged = {}
        for name, y in otherwise.items():
            if name in then:
                x = then[name]
                merged[name] = x if x is y else array_values.select(self.builder, condition, x, y)
        return merged
