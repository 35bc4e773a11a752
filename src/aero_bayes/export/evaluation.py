"""Evaluates syntax trees to expression graphs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from aero_bayes.errors import InputError
from aero_bayes.export import arrays
from aero_bayes.export.array_functions import ARRAY_FUNCTIONS, array_function
from aero_bayes.export.arrays import Record, ShapeError, Value, scalars
from aero_bayes.export.events import Events
from aero_bayes.export.expression import Builder, Node
from aero_bayes.export.flat import Function
from aero_bayes.export.names import NameTable
from aero_bayes.export.operators import Operators
from aero_bayes.export.tables import call_table, is_table_function
from aero_bayes.language.syntax import (
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
from aero_bayes.language.tokens import SourceLocation
from aero_bayes.language.values import BINARY, OPERATORS, RELATIONS, UNARY

MAX_UNROLLED = 10_000


class Evaluator(NameTable):
    """Evaluates syntax trees where names mean ``values``."""

    def __init__(
        self,
        builder: Builder,
        functions: Mapping[str, Function],
        values: dict[str, Value],
        where: str,
        *,
        events: Events | None = None,
        records: Mapping[str, tuple[str, ...]] | None = None,
    ) -> None:
        super().__init__(values, records or {})
        self.builder = builder
        self.functions = functions
        self.where = where
        self.operators = Operators(builder, events)
        self.place: SourceLocation | None = None

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
                return arrays.select(self.builder, chosen, self.value(then), self.value(otherwise))
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
                return [self._element(arrays.element(self.builder, value, i), rest, name) for i in scalars(index)]
            if isinstance(index, Node):
                return self._element(arrays.element(self.builder, value, index), rest, name)
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
        if special is None:
            special = self._event_operator(function, args)
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
            return arrays.mapped(lambda n: self.builder.unary(function, n), values[0])
        op = OPERATORS.get(function, "")
        if len(values) == 2 and op in BINARY:
            left, right = values
            if op in RELATIONS:
                return self.operators.relation(op, left, right)
            if isinstance(left, list) and isinstance(right, list) and function in ("*", "/", "^"):
                if function != "*":
                    raise self.fail(f"the matrix operation {function!r}")
                return arrays.product(self.builder, left, right)
            if op == "div" and any(n is self.builder.zero for n in scalars(right)):
                raise self.fail("a division by zero")
            return arrays.elementwise(lambda a, b: self.builder.binary(op, a, b), left, right)
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
                return arrays.concatenated([self.value(i) for i in items], self.integer(dimension) - 1)
        return None

    def _event_operator(self, function: str, args: tuple[Expression, ...]) -> Value | None:
        """Operators that depend on time or make events."""
        operators, events = self.operators, self.operators.events
        match function, args:
            case "der", (tree,):
                return operators.der(self.value(tree))
            case ("pre" | "edge" | "change") as op, (tree,):
                value = self.value(tree)
                if events is None:
                    raise self.fail(f"{op}() outside of equations")
                try:
                    return {"pre": operators.pre, "edge": operators.edge, "change": operators.change}[op](value)
                except LookupError as error:
                    raise self.fail(str(error)) from None
            case "initial", ():
                return events.initial if events is not None else self.builder.zero
            case "sample", (start, interval):
                if events is None:
                    raise self.fail("sample() outside of equations")
                return events.sample(self.scalar(start), self.scalar(interval))
            case ("floor" | "ceil" | "integer") as op, (tree,):
                return operators.rounded(op, self.value(tree))
            case ("div" | "mod" | "rem") as op, (x, y):
                return operators.divided(op, self.value(x), self.value(y))
            case "semiLinear", (x, up, down):
                return operators.semi_linear(self.scalar(x), self.value(up), self.value(down))
        return None
