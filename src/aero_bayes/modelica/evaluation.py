"""Evaluates syntax trees to expression graphs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial, reduce

from aero_bayes.errors import InputError
from aero_bayes.modelica import array_values
from aero_bayes.modelica.array_values import Record, ShapeError, Value, scalars
from aero_bayes.modelica.expression import Builder, Node
from aero_bayes.modelica.flat import Function
from aero_bayes.modelica.operators import EVENT_OPERATORS, Events, Operators, call_table, is_table_function
from aero_bayes.modelica.parse import BINARY, OPERATORS, RELATIONS, UNARY, SourceLocation
from aero_bayes.modelica.syntax import (
    Array,
    Call,
    Comprehension,
    Expression,
    Field,
    If,
    Index,
    Name,
    Number,
    RangeExpression,
    Text,
    WholeDimension,
    short_text,
)

ARRAY_FUNCTIONS = frozenset(
    {"sum", "product", "min", "max", "size", "ndims", "fill", "zeros", "ones", "scalar", "vector", "matrix",
     "transpose", "identity", "diagonal", "linspace", "cross", "[,]", "[;]", "cat"}
)  # fmt: skip


def array_function(b: Builder, function: str, args: list[Value]) -> Value | None:
    """Return the value of a function of :data:`ARRAY_FUNCTIONS`, or None where it means the function of numbers."""

    match function, args:
        case "size", (value,):
            return [b.const(float(n)) for n in array_values.shape(value)]
        case "size", (value, dimension):
            sizes = array_values.shape(value)
            if not 1 <= _whole(dimension) <= len(sizes):
                raise ShapeError("size() of a dimension that is not there")
            return b.const(float(sizes[_whole(dimension) - 1]))
        case "ndims", (value,):
            return b.const(float(len(array_values.shape(value))))
        case "fill", (item, *sizes):
            return array_values.filled(item, [_whole(s) for s in sizes])
        case (("zeros" | "ones"), _):
            return array_values.filled(b.const(float(function == "ones")), [_whole(s) for s in args])
        case "identity", (size,):
            n = _whole(size)
            return [[b.const(float(i == j)) for j in range(n)] for i in range(n)]
        case "diagonal", (value,):
            items = scalars(value)
            return [[x if i == j else b.zero for j in range(len(items))] for i, x in enumerate(items)]
        case "linspace", (first, last, count):
            n = _whole(count)
            width = array_values.elementwise(b.sub, last, first)
            steps = [array_values.elementwise(b.mul, b.const(k / (n - 1)), width) for k in range(n)]
            return [array_values.elementwise(b.add, first, step) for step in steps]
        case "cross", (x, y):
            u, v = scalars(x), scalars(y)
            return [b.sub(b.mul(u[i], v[j]), b.mul(u[j], v[i])) for i, j in ((1, 2), (2, 0), (0, 1))]
        case "transpose", (value,):
            return array_values.transposed(value)
        case "[,]", _:
            return array_values.concatenated(args, 1)
        case "[;]", _:
            return array_values.concatenated(args, 0)
        case "sum", (value,):
            return array_values.total(b, value)
        case "vector", (value,):
            return list(scalars(value))
        case "matrix", (value,):
            return array_values.concatenated([value], 1)
        case "scalar", (value,):
            if len(scalars(value)) == 1:
                return scalars(value)[0]
        case (("product" | "min" | "max"), (value,)):
            operation = "mul" if function == "product" else function
            if items := scalars(value):
                return reduce(partial(b.binary, operation), items)
    return None


def _whole(value: Value) -> int:
    if not isinstance(value, Node) or value.op != "const" or not value.value.is_integer():
        raise ShapeError("a size that is not a constant whole number")
    return int(value.value)


MAX_UNROLLED = 10_000


class Evaluator:
    """Evaluates syntax trees where names mean ``values``; the fields of ``records`` are variables of their own."""

    def __init__(
        self,
        builder: Builder,
        functions: Mapping[str, Function],
        values: dict[str, Value],
        where: str,
        *,
        records: Mapping[str, tuple[str, ...]] | None = None,
    ) -> None:
        self.values = values
        self.records = records or {}
        self._families: dict[str, list[str]] | None = None
        self.builder = builder
        self.functions = functions
        self.where = where
        self.operators = Operators(builder)
        self.place: SourceLocation | None = None

    def named(self, name: str) -> Value:
        """Return the value of a name: a variable, a record, a field of one, or that field of an array of records."""
        if name in self.values:
            return self.values[name]
        if name in self.records:
            return Record(self.records[name], [self.named(f"{name}.{f}") for f in self.records[name]])
        owner, dot, last = name.rpartition(".")
        if dot and isinstance(whole := self.values.get(owner), Record) and last in whole.names:
            return whole.field(last)
        members = self._family(name)
        if members:
            return [self.named(m) for m in members]
        raise KeyError(name)

    def _family(self, name: str) -> list[str]:
        """Return names such as ``r[1].v``, ``r[2].v`` that ``r.v`` stands for, in order."""
        if self._families is None:
            self._families = {}
            for n in self.values:
                plain = re.sub(r"\[\d+\]", "", n, count=1)
                if plain != n:
                    self._families.setdefault(plain, []).append(n)
        return self._families.get(name, [])

    def assign(self, name: str, indices: Sequence[int], value: Value) -> None:
        """Give a name, or the element at `indices` of an array, another value."""
        owner, dot, last = name.rpartition(".")
        if dot and isinstance(whole := self.values.get(owner), Record) and not indices:
            at = whole.names.index(last)
            self.values[owner] = Record(whole.names, [value if i == at else v for i, v in enumerate(whole)])
            return
        self.values[name] = array_values.replaced(self.values[name], indices, value) if indices else value

    def call_function(self, function: Function, args: tuple[Expression, ...]) -> Value:
        """Return the result of a function of the model."""
        raise NotImplementedError

    def fail(self, what: str) -> InputError:
        """Return the error for a construct that cannot be translated."""
        return InputError(f"{self.place or self.where}: the embedded exporter cannot translate {what}")

    @contextmanager
    def events_in(self, events: Events | None) -> Iterator[None]:
        """Collect events elsewhere, or none of them, within a block."""
        saved, self.operators.events = self.operators.events, events
        try:
            yield
        finally:
            self.operators.events = saved

    def scalar(self, tree: Expression) -> Node:
        """Return the value of a tree that has to be a number."""
        value = self.value(tree)
        if not isinstance(value, Node):
            raise self.fail(f"an array where a number is needed ({short_text(tree)})")
        return value

    def integer(self, tree: Expression) -> int:
        """Return the value of a tree that has to be a constant whole number, such as a size."""
        node = self.scalar(tree)
        if node.op != "const" or not node.value.is_integer():
            raise self.fail(f"an index or size that is not a constant whole number ({short_text(tree)})")
        return int(node.value)

    def value(self, tree: Expression) -> Value:
        """Return the value of a tree. Raises InputError, with file and line, for what cannot be translated."""
        try:
            return self._value(tree)
        except InputError:
            raise
        except ShapeError as error:
            raise self.fail(f"{error} ({short_text(tree)})") from None
        except (ArithmeticError, ValueError, TypeError) as error:
            raise self.fail(f"the constant {short_text(tree)}: {error}") from None

    def _value(self, tree: Expression) -> Value:
        match tree:
            case Number(value):
                return self.builder.const(value)
            case Name(name, subscripts):
                return self._element(self._variable(name), subscripts, name)
            case If(condition, then, otherwise):
                chosen = self.scalar(condition)
                if chosen.op == "const":
                    return self.value(then if chosen.value else otherwise)
                return array_values.select(self.builder, chosen, self.value(then), self.value(otherwise))
            case Array(items):
                return [self.value(i) for i in items]
            case Comprehension(item, variable, values):
                return [self.value(item) for _ in self._each(variable, values)]
            case RangeExpression():
                return [self.builder.const(v) for v in self._range(tree)]
            case Call(function, args):
                return self._call(function, args)
            case Index(of, subscripts):
                return self._element(self.value(of), subscripts, short_text(of))
            case Field(of, name):
                return self._field(of, name)
            case Text(value):
                return value
        raise self.fail(short_text(tree))

    def _variable(self, name: str) -> Value:
        try:
            return self.named(name)
        except KeyError as error:
            raise self.fail(f"the name {error.args[0]!r}, which is not declared as a number") from None

    def _field(self, of: Expression, name: str) -> Value:
        if isinstance(of, Name) and not of.subscripts:
            return self._variable(f"{of.name}.{name}")
        value = self.value(of)
        if isinstance(value, Record) and name in value.names:
            return value.field(name)
        raise self.fail(f"the field {name!r} of {short_text(of)}")

    def _element(self, value: Value, subscripts: Sequence[Expression], name: str) -> Value:
        if not subscripts:
            return value
        if not isinstance(value, list):
            raise self.fail(f"a subscript of {name!r}, which is a number")
        first, rest = subscripts[0], subscripts[1:]
        if isinstance(first, WholeDimension):
            return [self._element(v, rest, name) for v in value]
        index = self.value(first)
        try:
            if isinstance(index, list):
                return [self._element(array_values.element(self.builder, value, i), rest, name) for i in scalars(index)]
            if isinstance(index, Node):
                return self._element(array_values.element(self.builder, value, index), rest, name)
        except IndexError as error:
            raise self.fail(f"the subscript {error} of {name!r}") from None
        raise self.fail(f"a subscript of {name!r}")

    def _range(self, tree: RangeExpression) -> list[float]:
        first, last = self.integer(tree.first), self.integer(tree.last)
        step = self.integer(tree.step) if tree.step is not None else 1
        if step == 0:
            raise self.fail("a range with step 0")
        values = range(first, last + (1 if step > 0 else -1), step)
        if len(values) > MAX_UNROLLED:
            raise self.fail(f"a loop of {len(values)} turns (at most {MAX_UNROLLED} are unrolled)")
        return [float(v) for v in values]

    def _each(self, variable: str, values: Expression) -> Iterator[None]:
        """Gives the loop variable its values, one a turn."""
        over = self.value(values)
        if not isinstance(over, list):
            raise self.fail("a loop over something that is not an array")
        saved = self.values.get(variable)
        for v in over:
            self.values[variable] = v
            yield
        if saved is None:
            self.values.pop(variable, None)
        else:
            self.values[variable] = saved

    def _call(self, function: str, args: tuple[Expression, ...]) -> Value:
        special = self._special(function, args)
        if special is None and function in EVENT_OPERATORS:
            given = [self.value(a) for a in args]
            try:
                special = self.operators.call(function, given)
            except LookupError as error:
                raise self.fail(str(error)) from None
        if special is not None:
            return special
        if is_table_function(function):
            found = call_table(self.builder, function, [self.value(a) for a in args], self.operators.events)
            if found is not None:
                return found
        if function in self.functions:
            return self.call_function(self.functions[function], args)
        if function in ARRAY_FUNCTIONS:
            found = array_function(self.builder, function, [self.value(a) for a in args])
            if found is not None:
                return found
        values = [self.value(a) for a in args]
        if len(values) == 1 and function in UNARY:
            return array_values.mapped(lambda n: self.builder.unary(function, n), values[0])
        op = OPERATORS.get(function, "")
        if len(values) == 2 and op in BINARY:
            left, right = values
            if op in RELATIONS:
                return self.operators.relation(op, left, right)
            if isinstance(left, list) and isinstance(right, list) and function in ("*", "/", "^"):
                if function != "*":
                    raise self.fail(f"the matrix operation {function!r}")
                return array_values.product(self.builder, left, right)
            if op == "div" and any(n is self.builder.zero for n in scalars(right)):
                raise self.fail("a division by zero")
            return array_values.elementwise(lambda a, b: self.builder.binary(op, a, b), left, right)
        raise self.fail(f"{function!r} with {len(args)} arguments")

    def _special(self, function: str, args: tuple[Expression, ...]) -> Value | None:
        """Operators that do not take all of their arguments' values."""
        match function, args:
            case (("and" | "or"), (first, _)):
                left = self.value(first)
                if isinstance(left, Node) and left.op == "const" and bool(left.value) is (function == "or"):
                    return left  # the other side may have no value then
            case ("noEvent", (tree,)) | ("smooth", (_, tree)):
                with self.events_in(None):
                    return self.value(tree)
            case ("homotopy", (tree, *_)) | (("Integer" | "Real" | "Boolean" | "String"), (tree, *_)):
                return self.value(tree)
            case "terminal", ():
                return self.builder.zero
            case "cat", (dimension, *items):
                return array_values.concatenated([self.value(i) for i in items], self.integer(dimension) - 1)
        return None
