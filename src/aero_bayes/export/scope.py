"""Evaluates syntax trees to expression graphs: names, arrays, loops, branches, functions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from aero_bayes.errors import InputError
from aero_bayes.export import arrays
from aero_bayes.export.array_functions import ARRAY_FUNCTIONS, array_function
from aero_bayes.export.arrays import Record, ShapeError, Value, numbers
from aero_bayes.export.choices import choices
from aero_bayes.export.events import Events
from aero_bayes.export.expression import Builder, Node
from aero_bayes.export.flat import FlatEquation, Function
from aero_bayes.export.solved import unsolved
from aero_bayes.export.tables import call_table, is_table_function, searched_anew
from aero_bayes.language.syntax import (
    All,
    Array,
    AssertStatement,
    Assign,
    Call,
    Comprehension,
    Expression,
    Field,
    ForStatement,
    If,
    IfStatement,
    Index,
    Name,
    Number,
    Range,
    Refused,
    Statement,
    Text,
    WhileStatement,
    show,
)
from aero_bayes.language.tokens import Place
from aero_bayes.language.values import BINARY, OPERATORS, RELATIONS, UNARY

MAX_UNROLLED = 10_000
MAX_TURNS = 1000


class Scope:
    """Evaluates syntax trees where names mean ``values``.

    ``events`` collects what makes events; where it is None relations are taken as they are at any instant.
    """

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
        self.builder = builder
        self.functions = functions
        self.values = values
        self.where = where
        self.events = events
        self.records = records or {}
        self.derivatives: dict[str, Node] = {}
        self.left_limits: dict[Node, Node] = {}
        self.place: Place | None = None
        self.depth = 0
        self._families: dict[str, list[str]] | None = None

    def fail(self, what: str) -> InputError:
        return InputError(f"{self.place or self.where}: the embedded exporter cannot translate {what}")

    def scalar(self, tree: Expression) -> Node:
        value = self.value(tree)
        if not isinstance(value, Node):
            raise self.fail(f"an array where a number is needed ({show(tree)})")
        return value

    def integer(self, tree: Expression) -> int:
        node = self.scalar(tree)
        if node.op != "const" or not node.value.is_integer():
            raise self.fail(f"an index or size that is not a constant whole number ({show(tree)})")
        return int(node.value)

    def value(self, tree: Expression) -> Value:
        try:
            return self._value(tree)
        except InputError:
            raise
        except ShapeError as error:
            raise self.fail(f"{error} ({show(tree)})") from None
        except (ArithmeticError, ValueError, TypeError) as error:
            raise self.fail(f"the constant {show(tree)}: {error}") from None

    def _value(self, tree: Expression) -> Value:
        match tree:
            case Number(value):
                return self.builder.const(value)
            case Name(name, subscripts):
                return self._element(self._named(name), subscripts, name)
            case If(condition, then, otherwise):
                chosen = self.scalar(condition)
                if chosen.op == "const":
                    return self.value(then if chosen.value else otherwise)
                return arrays.select(self.builder, chosen, self.value(then), self.value(otherwise))
            case Array(items):
                return [self.value(i) for i in items]
            case Comprehension(item, variable, values):
                return [self.value(item) for _ in self._each(variable, values)]
            case Range():
                return [self.builder.const(v) for v in self._range(tree)]
            case Call(function, args):
                return self._call(function, args)
            case Index(of, subscripts):
                return self._element(self.value(of), subscripts, show(of))
            case Field(of, name):
                return self._field(of, name)
            case Text(value):
                return value
        raise self.fail(show(tree))

    # names

    def _named(self, name: str) -> Value:
        if name in self.values:
            return self.values[name]
        if name in self.records:
            return Record(self.records[name], [self._named(f"{name}.{f}") for f in self.records[name]])
        owner, dot, last = name.rpartition(".")
        if dot and isinstance(whole := self.values.get(owner), Record) and last in whole.names:
            return whole.field(last)
        members = self._family(name)
        if members:
            return [self._named(m) for m in members]
        raise self.fail(f"the name {name!r}, which is not declared as a number")

    def _family(self, name: str) -> list[str]:
        """Names such as ``r[1].v``, ``r[2].v`` that ``r.v`` stands for, in order."""
        if self._families is None:
            self._families = {}
            for n in self.values:
                plain = re.sub(r"\[\d+\]", "", n, count=1)
                if plain != n:
                    self._families.setdefault(plain, []).append(n)
        return self._families.get(name, [])

    def _field(self, of: Expression, name: str) -> Value:
        if isinstance(of, Name) and not of.subscripts:
            return self._named(f"{of.name}.{name}")
        value = self.value(of)
        if isinstance(value, Record) and name in value.names:
            return value.field(name)
        raise self.fail(f"the field {name!r} of {show(of)}")

    def _element(self, value: Value, subscripts: Sequence[Expression], name: str) -> Value:
        if not subscripts:
            return value
        if not isinstance(value, list):
            raise self.fail(f"a subscript of {name!r}, which is a number")
        first, rest = subscripts[0], subscripts[1:]
        if isinstance(first, All):
            return [self._element(v, rest, name) for v in value]
        index = self.value(first)
        if isinstance(index, list):
            return [self._element(self._at(value, i, name), rest, name) for i in numbers(index)]
        if not isinstance(index, Node):
            raise self.fail(f"a subscript of {name!r}")
        return self._element(self._at(value, index, name), rest, name)

    def _at(self, value: list[Value], index: Node, name: str) -> Value:
        if index.op != "const":
            chosen = value[-1]
            for k in range(len(value) - 1, 0, -1):
                here = self.builder.binary("eq", index, self.builder.const(float(k)))
                chosen = arrays.select(self.builder, here, value[k - 1], chosen)
            return chosen
        if not index.value.is_integer() or not 1 <= index.value <= len(value):
            raise self.fail(f"the subscript {index.value:g} of {name!r}")
        return value[int(index.value) - 1]

    # loops

    def _range(self, tree: Range) -> list[float]:
        first, last = self.integer(tree.first), self.integer(tree.last)
        step = self.integer(tree.step) if tree.step is not None else 1
        if step == 0:
            raise self.fail("a range with step 0")
        values = range(first, last + (1 if step > 0 else -1), step)
        if len(values) > MAX_UNROLLED:
            raise self.fail(f"a loop of {len(values)} turns (at most {MAX_UNROLLED} are unrolled)")
        return [float(v) for v in values]

    def _each(self, variable: str, values: Expression) -> Iterable[None]:
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

    # calls

    def _call(self, function: str, args: tuple[Expression, ...]) -> Value:
        special = self._special(function, args)
        if special is not None:
            return special
        if is_table_function(function):
            found = call_table(self.builder, function, [self.value(a) for a in args], self.events)
            if found is not None:
                return found
        if function in self.functions:
            return self._user(self.functions[function], args)
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
                return self._relation(op, left, right)
            if isinstance(left, list) and isinstance(right, list) and function in ("*", "/", "^"):
                if function != "*":
                    raise self.fail(f"the matrix operation {function!r}")
                return arrays.product(self.builder, left, right)
            if op == "div" and any(n is self.builder.zero for n in numbers(right)):
                raise self.fail("a division by zero")
            return arrays.elementwise(lambda a, b: self.builder.binary(op, a, b), left, right)
        raise self.fail(f"{function!r} with {len(args)} arguments")

    def _relation(self, op: str, left: Value, right: Value) -> Value:
        if isinstance(left, str) and isinstance(right, str) and op in ("eq", "ne"):
            return self.builder.const(float((left == right) is (op == "eq")))
        if self.events is None:
            return arrays.elementwise(lambda a, b: self.builder.binary(op, a, b), left, right)
        events = self.events
        return arrays.elementwise(lambda a, b: events.relation(op, a, b), left, right)

    def _special(self, function: str, args: tuple[Expression, ...]) -> Value | None:
        """Operators that are no functions of their arguments' values."""
        b = self.builder
        match function, args:
            case (("and" | "or"), (first, _)):
                left = self.value(first)
                if isinstance(left, Node) and left.op == "const" and bool(left.value) is (function == "or"):
                    return left  # the other side may have no value then
            case "der", (tree,):
                return self._der(tree)
            case "noEvent", (tree,):
                return self._quietly(tree)
            case "smooth", (_, tree):
                return self._quietly(tree)
            case ("pre" | "edge" | "change") as op, (tree,):
                value = self.value(tree)
                if self.events is None:
                    raise self.fail(f"{op}() outside of equations")
                before = arrays.mapped(self._pre, value)
                if op == "pre":
                    return before
                if op == "change":
                    return arrays.elementwise(lambda x, y: b.binary("ne", x, y), value, before)
                return arrays.elementwise(lambda x, y: b.binary("and", x, b.unary("not", y)), value, before)
            case "initial", ():
                return self.events.initial if self.events is not None else b.zero
            case "terminal", ():
                return b.zero
            case "sample", (start, interval):
                if self.events is None:
                    raise self.fail("sample() outside of equations")
                return self.events.sample(self.scalar(start), self.scalar(interval))
            case ("floor" | "ceil" | "integer") as op, (tree,):
                return arrays.mapped(lambda n: self._round(op, n), self.value(tree))
            case ("div" | "mod" | "rem") as op, (x, y):
                return arrays.elementwise(lambda n, m: self._divide(op, n, m), self.value(x), self.value(y))
            case "homotopy", (tree, *_):
                return self.value(tree)
            case "cat", (dimension, *items):
                return arrays.joined([self.value(i) for i in items], self.integer(dimension) - 1)
            case "semiLinear", (x, up, down):
                flow = self.scalar(x)
                slopes = self._relation("ge", flow, b.zero)
                return arrays.elementwise(
                    b.mul, arrays.select(b, numbers(slopes)[0], self.value(up), self.value(down)), flow
                )
            case (("Integer" | "Real" | "Boolean" | "String"), (tree, *_)):
                return self.value(tree)
        return None

    def _pre(self, node: Node) -> Node:
        if node.name.startswith("pre("):
            return node  # in an algorithm, before it assigns the variable
        if self.events is not None and self.events.constant_between(node):
            return self.events.pre(node) if node.op == "symbol" else node
        if node.op == "symbol":
            limit = self.builder.symbol(f"left({node.name})")
            self.left_limits[limit] = node
            return limit
        raise self.fail("pre() of something that is not a variable")

    def _quietly(self, tree: Expression) -> Value:
        saved, self.events = self.events, None
        try:
            return self.value(tree)
        finally:
            self.events = saved

    def _floor(self, x: Node) -> Node:
        return self.builder.unary("floor", x) if self.events is None else self.events.floor(x)

    def _round(self, op: str, x: Node) -> Node:
        if op == "ceil":
            return self.builder.neg(self._floor(self.builder.neg(x)))
        return self._floor(x)

    def _divide(self, op: str, x: Node, y: Node) -> Node:
        b = self.builder
        ratio = b.div(x, y)
        if op == "mod":
            return b.sub(x, b.mul(self._floor(ratio), y))
        sign = self._relation("ge", ratio, b.zero)
        down, up = self._floor(ratio), b.neg(self._floor(b.neg(ratio)))
        whole = b.select(sign, down, up) if isinstance(sign, Node) else down
        return whole if op == "div" else b.sub(x, b.mul(whole, y))

    def _der(self, tree: Expression) -> Value:
        b = self.builder

        def rate(node: Node) -> Node:
            if node.op == "symbol" and node.name != "time" and not self._held(node):
                derivative = b.symbol(f"der({node.name})")
                self.derivatives[node.name] = derivative
                return derivative
            result = b.zero
            for symbol in sorted(b.symbols(node), key=lambda s: s.index):
                slope = b.derivative(node, symbol)
                if symbol.name == "time":
                    result = b.add(result, slope)
                elif slope is not b.zero and not self._held(symbol):
                    result = b.add(result, b.mul(slope, rate(symbol)))
            return result

        return arrays.mapped(rate, self.value(tree))

    def _held(self, symbol: Node) -> bool:
        return self.events is not None and symbol in self.events.held

    def sides(self, equations: Sequence[FlatEquation]) -> list[tuple[Node, Node]]:
        """Left and right side of each equation, number by number."""
        found: list[tuple[Node, Node]] = []
        for equation in map(unsolved, equations):
            self.place = equation.place
            left, right = self.value(equation.left), self.value(equation.right)
            try:
                found += arrays.pairs(left, right)
            except ShapeError as error:
                raise self.fail(f"{error} in one equation") from None
        self.place = None
        return found

    # functions

    def _user(self, function: Function, args: tuple[Expression, ...]) -> Value:
        if self.depth > 50:
            raise self.fail(f"the recursive function {function.name!r}")
        if len(args) > len(function.inputs):
            raise self.fail(f"function {function.name!r} called with {len(args)} arguments")
        inner = Scope(self.builder, self.functions, {}, f"function {function.name}", records=self.records)
        inner.depth = self.depth + 1
        for a, tree in zip(function.inputs, searched_anew(function.name, args), strict=False):
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
            elif a.sizes and not any(isinstance(s, All) for s in a.sizes):
                inner.values[a.name] = arrays.filled(self.builder.zero, [inner.integer(s) for s in a.sizes])
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
                case Refused(what):
                    raise self.fail(what)
                case _:
                    raise self.fail(f"{type(statement).__name__.removesuffix('Statement').lower()!r} in an algorithm")

    def _assign(self, target: Name | None, value: Value) -> None:
        if target is None:
            return
        owner, dot, last = target.name.rpartition(".")
        if dot and isinstance(whole := self.values.get(owner), Record) and not target.subscripts:
            at = whole.names.index(last)
            self.values[owner] = Record(whole.names, [value if i == at else v for i, v in enumerate(whole)])
            return
        if target.subscripts:
            if target.name not in self.values:
                raise self.fail(f"the assignment to an element of {target.name!r}")
            indices = [self.integer(s) for s in target.subscripts]
            value = arrays.replaced(self.values[target.name], indices, value)
        self.values[target.name] = value

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
            if choices(self.builder, going) == frozenset((0.0,)):
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
                merged[name] = x if x is y else arrays.select(self.builder, condition, x, y)
        return merged
