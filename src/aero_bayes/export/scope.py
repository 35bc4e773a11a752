"""Evaluates syntax trees to expression graphs: names, arrays, loops, branches, functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aero_bayes.errors import InputError
from aero_bayes.export.expression import BINARY, UNARY, Builder, Node
from aero_bayes.export.syntax import (
    Array,
    Assign,
    Call,
    Comprehension,
    Equal,
    Equation,
    Expression,
    ForStatement,
    Function,
    If,
    IfStatement,
    Index,
    Name,
    Number,
    Range,
    Statement,
    Text,
)

Value = Node | list["Value"]

_OPERATORS = {
    "+": "add", "-": "sub", "*": "mul", "/": "div", "^": "pow",
    ".+": "add", ".-": "sub", ".*": "mul", "./": "div", ".^": "pow",
    "<": "lt", "<=": "le", ">": "gt", ">=": "ge", "==": "eq", "<>": "ne",
    "and": "and", "or": "or", "min": "min", "max": "max", "atan2": "atan2",
}  # fmt: skip
_TRANSPARENT = frozenset({"noEvent", "homotopy"})
MAX_UNROLLED = 10_000


class Scope:
    """Evaluates syntax trees where names mean ``values``."""

    def __init__(
        self, builder: Builder, functions: Mapping[str, Function], values: dict[str, Value], where: str
    ) -> None:
        self.builder = builder
        self.functions = functions
        self.values = values
        self.where = where
        self.derivatives: dict[str, Node] = {}
        self.depth = 0

    def fail(self, what: str) -> InputError:
        return InputError(f"{self.where}: the embedded exporter cannot translate {what}")

    def scalar(self, tree: Expression) -> Node:
        value = self.value(tree)
        if isinstance(value, list):
            raise self.fail(f"an array where a number is needed ({show(tree)})")
        return value

    def integer(self, tree: Expression) -> int:
        node = self.scalar(tree)
        if node.op != "const" or not node.value.is_integer():
            raise self.fail(f"an index or size that is not a constant whole number ({show(tree)})")
        return int(node.value)

    def value(self, tree: Expression) -> Value:
        match tree:
            case Number(value):
                return self.builder.const(value)
            case Name(name, subscripts):
                return self._reference(name, subscripts)
            case If(condition, then, otherwise):
                chosen = self.scalar(condition)
                if chosen.op == "const":
                    return self.value(then if chosen.value else otherwise)
                return self._select(chosen, self.value(then), self.value(otherwise))
            case Array(items):
                return [self.value(i) for i in items]
            case Comprehension(item, variable, values):
                return self._comprehension(item, variable, values)
            case Range():
                return [self.builder.const(v) for v in self._range(tree)]
            case Call(function, args):
                return self._call(function, args)
            case Index(of, subscripts):
                return self._element(self.value(of), subscripts, show(of))
            case Text(value):
                raise self.fail(f"the string {value!r} in an expression")
        raise self.fail(show(tree))

    def _reference(self, name: str, subscripts: tuple[Expression, ...]) -> Value:
        if name not in self.values:
            raise self.fail(f"the name {name!r}, which is not declared as a number")
        return self._element(self.values[name], subscripts, name)

    def _element(self, value: Value, subscripts: tuple[Expression, ...], name: str) -> Value:
        for s in subscripts:
            index = self.integer(s)
            if not isinstance(value, list) or not 1 <= index <= len(value):
                raise self.fail(f"the subscript {index} of {name!r}")
            value = value[index - 1]
        return value

    def _range(self, tree: Range) -> list[float]:
        first, last = self.integer(tree.first), self.integer(tree.last)
        step = self.integer(tree.step) if tree.step is not None else 1
        if step == 0:
            raise self.fail("a range with step 0")
        values = range(first, last + (1 if step > 0 else -1), step)
        if len(values) > MAX_UNROLLED:
            raise self.fail(f"a loop of {len(values)} turns (at most {MAX_UNROLLED} are unrolled)")
        return [float(v) for v in values]

    def _comprehension(self, item: Expression, variable: str, values: Expression) -> list[Value]:
        over = self.value(values)
        if not isinstance(over, list):
            raise self.fail("a loop over something that is not an array")
        saved = self.values.get(variable)
        result = []
        for v in over:
            self.values[variable] = v
            result.append(self.value(item))
        self._restore(variable, saved)
        return result

    def _restore(self, variable: str, saved: Value | None) -> None:
        if saved is None:
            self.values.pop(variable, None)
        else:
            self.values[variable] = saved

    def _select(self, condition: Node, a: Value, b: Value) -> Value:
        if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
            return [self._select(condition, x, y) for x, y in zip(a, b, strict=True)]
        if isinstance(a, list) or isinstance(b, list):
            raise self.fail("an if-expression with branches of different size")
        return self.builder.select(condition, a, b)

    def _elementwise(self, op: str, a: Value, b: Value) -> Value:
        if isinstance(a, list) and isinstance(b, list):
            if len(a) != len(b):
                raise self.fail(f"arrays of different size under {op!r}")
            return [self._elementwise(op, x, y) for x, y in zip(a, b, strict=True)]
        if isinstance(a, list):
            return [self._elementwise(op, x, b) for x in a]
        if isinstance(b, list):
            return [self._elementwise(op, a, y) for y in b]
        try:
            return self.builder.binary(op, a, b)
        except (ArithmeticError, ValueError, TypeError) as error:
            raise self.fail(f"the constant {a!r} {op} {b!r}: {error}") from None

    def _call(self, function: str, args: tuple[Expression, ...]) -> Value:
        if function == "der":
            return self._der(args)
        if function in _TRANSPARENT and args:
            return self.value(args[0])
        if function == "smooth" and len(args) == 2:
            return self.value(args[1])
        if function in self.functions:
            return self._user(self.functions[function], args)
        if function in ("sum", "product", "min", "max", "size", "fill", "zeros", "ones", "scalar", "vector"):
            special = self._array_function(function, args)
            if special is not None:
                return special
        values = [self.value(a) for a in args]
        op = "neg" if function == "neg" else function
        if len(values) == 1 and op in UNARY:
            return self._unary(op, values[0])
        op = _OPERATORS.get(function, "")
        if len(values) == 2 and op in BINARY:
            left, right = values
            if isinstance(left, list) and isinstance(right, list) and function in ("*", "/", "^"):
                if function != "*":
                    raise self.fail(f"the matrix operation {function!r}")
                return self._product(left, right)
            return self._elementwise(op, left, right)
        raise self.fail(f"{function!r} with {len(args)} arguments")

    def _product(self, left: list[Value], right: list[Value]) -> Value:
        """Vector or matrix product."""
        if left and isinstance(left[0], list):
            return [self._product(row, right) for row in left if isinstance(row, list)]
        if right and isinstance(right[0], list):
            columns = [[row[j] for row in right if isinstance(row, list)] for j in range(len(right[0]))]
            return [self._product(left, column) for column in columns]
        return self._sum(self._elementwise("mul", left, right))

    def _unary(self, op: str, value: Value) -> Value:
        if isinstance(value, list):
            return [self._unary(op, v) for v in value]
        try:
            return self.builder.unary(op, value)
        except (ArithmeticError, ValueError) as error:
            raise self.fail(f"the constant {op}({value!r}): {error}") from None

    def _der(self, args: tuple[Expression, ...]) -> Value:
        tree = args[0]
        if len(args) != 1 or not isinstance(tree, Name):
            raise self.fail("der() of something that is not a variable")
        return self._rate(self.value(tree), show(tree))

    def _rate(self, value: Value, name: str) -> Value:
        if isinstance(value, list):
            return [self._rate(v, name) for v in value]
        if value.op != "symbol":
            raise self.fail(f"der({name}), the derivative of a parameter or constant")
        derivative = self.builder.symbol(f"der({value.name})")
        self.derivatives[value.name] = derivative
        return derivative

    def residuals(self, equations: Sequence[Equation]) -> list[Node]:
        """Right minus left side, number by number. A loop around a whole-array equation counts once."""
        found: list[Node] = []
        for equation in equations:
            if isinstance(equation, Equal):
                found += numbers(self._elementwise("sub", self.value(equation.right), self.value(equation.left)))
                continue
            if equation.variable.startswith("__array_"):
                found += self.residuals(equation.body)
                continue
            over = self.value(equation.values)
            if not isinstance(over, list):
                raise self.fail("a loop over something that is not an array")
            saved = self.values.get(equation.variable)
            for v in over:
                self.values[equation.variable] = v
                found += self.residuals(equation.body)
            self._restore(equation.variable, saved)
        return found

    def _array_function(self, function: str, args: tuple[Expression, ...]) -> Value | None:
        if function == "size":
            value = self.value(args[0])
            for _ in range(self.integer(args[1]) - 1 if len(args) > 1 else 0):
                value = value[0] if isinstance(value, list) else value
            if not isinstance(value, list):
                raise self.fail(f"size() of a number ({show(args[0])})")
            return self.builder.const(float(len(value)))
        if function in ("fill", "zeros", "ones"):
            item = self.value(args[0]) if function == "fill" else self.builder.const(float(function == "ones"))
            for s in reversed(args[1:] if function == "fill" else args):
                item = [item] * self.integer(s)
            return item
        if len(args) != 1:
            return None
        value = self.value(args[0])
        if not isinstance(value, list):
            return value if function in ("sum", "product", "scalar") else None
        flat = numbers(value)
        if function == "sum":
            return self._sum(value)
        if function == "vector":
            return list(flat)
        if function == "scalar" and len(flat) == 1:
            return flat[0]
        if function == "scalar" or not flat:
            raise self.fail(f"{function}() of {len(flat)} numbers")
        result = flat[0]
        for n in flat[1:]:
            result = self.builder.binary("mul" if function == "product" else function, result, n)
        return result

    def _sum(self, value: Value) -> Node:
        result = self.builder.zero
        for n in numbers(value):
            result = self.builder.add(result, n)
        return result

    def _user(self, function: Function, args: tuple[Expression, ...]) -> Value:
        if self.depth > 50:
            raise self.fail(f"the recursive function {function.name!r}")
        inputs = [d for d in function.declarations if "input" in d.prefixes]
        outputs = [d for d in function.declarations if "output" in d.prefixes]
        if len(outputs) != 1:
            raise self.fail(f"function {function.name!r} with {len(outputs)} results")
        if len(args) > len(inputs):
            raise self.fail(f"function {function.name!r} called with {len(args)} arguments")
        inner = Scope(self.builder, self.functions, {}, f"function {function.name}")
        inner.depth = self.depth + 1
        for d, a in zip(inputs, args, strict=False):
            inner.values[d.name] = self.value(a)
        for d in function.declarations:
            if d.name not in inner.values and d.binding is not None:
                inner.values[d.name] = inner.value(d.binding)
        inner.run(function.body)
        if outputs[0].name not in inner.values:
            raise self.fail(f"function {function.name!r}, which does not assign its result")
        return inner.values[outputs[0].name]

    def run(self, body: Sequence[Statement]) -> None:
        for statement in body:
            match statement:
                case Assign(target, value):
                    self._assign(target, self.value(value))
                case ForStatement(variable, values, inner):
                    over = self.value(values)
                    if not isinstance(over, list):
                        raise self.fail("a loop over something that is not an array")
                    saved = self.values.get(variable)
                    for v in over:
                        self.values[variable] = v
                        self.run(inner)
                    self._restore(variable, saved)
                case IfStatement(branches, otherwise):
                    self._branch(branches, otherwise)

    def _assign(self, target: Name, value: Value) -> None:
        if not target.subscripts:
            self.values[target.name] = value
            return
        raise self.fail(f"the assignment to an element of {target.name!r}")

    def _branch(
        self, branches: Sequence[tuple[Expression, tuple[Statement, ...]]], otherwise: Sequence[Statement]
    ) -> None:
        if not branches:
            self.run(otherwise)
            return
        condition = self.scalar(branches[0][0])
        before = dict(self.values)
        self.run(branches[0][1])
        then = self.values
        self.values = before
        self._branch(branches[1:], otherwise)
        merged = dict(self.values)
        for name in then.keys() | merged.keys():
            if name in then and name in merged:
                a, b = then[name], merged[name]
                merged[name] = a if a is b else self._select(condition, a, b)
            else:
                merged.pop(name, None)
        self.values = merged


def numbers(value: Value) -> list[Node]:
    if isinstance(value, list):
        return [n for v in value for n in numbers(v)]
    return [value]


def show(tree: Expression) -> str:
    match tree:
        case Name(name, subscripts):
            return name + (f"[{','.join(map(show, subscripts))}]" if subscripts else "")
        case Number(value):
            return f"{value:g}"
        case Call(function, args):
            return f"{function}({', '.join(map(show, args))})"
    return type(tree).__name__.lower()
