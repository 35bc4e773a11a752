"""Syntax tree of the flat model -> expression graph: parameters, variables, residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

from aero_bayes.errors import InputError
from aero_bayes.export.expression import BINARY, UNARY, Builder, Node
from aero_bayes.export.flat import (
    Array,
    Assign,
    Call,
    Comprehension,
    Declaration,
    Expression,
    FlatModel,
    ForStatement,
    Function,
    If,
    IfStatement,
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


@dataclass(frozen=True)
class Variable:
    """A scalar of the model: its name, its attributes as expressions, and where it is declared to act."""

    name: str
    prefixes: frozenset[str]
    type: str
    description: str
    unit: str
    attributes: Mapping[str, Node]
    fixed: bool
    binding: Node | None


@dataclass(frozen=True)
class System:
    """Residuals ``0 = r`` over symbols. ``der(x)`` is the symbol of that name; dependent parameters are resolved."""

    name: str
    builder: Builder
    time: Node
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    variables: tuple[Variable, ...]
    residuals: tuple[Node, ...]
    initial_residuals: tuple[Node, ...]
    derivatives: dict[str, Node] = field(default_factory=dict)


class _Scope:
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
            raise self.fail(f"an array where a number is needed ({_show(tree)})")
        return value

    def integer(self, tree: Expression) -> int:
        node = self.scalar(tree)
        if node.op != "const" or not node.value.is_integer():
            raise self.fail(f"an index or size that is not a constant whole number ({_show(tree)})")
        return int(node.value)

    def value(self, tree: Expression) -> Value:
        match tree:
            case Number(value):
                return self.builder.const(value)
            case Name(name, subscripts):
                return self._reference(name, subscripts)
            case If(condition, then, otherwise):
                return self._select(self.scalar(condition), self.value(then), self.value(otherwise))
            case Array(items):
                return [self.value(i) for i in items]
            case Comprehension(item, variable, values):
                return self._comprehension(item, variable, values)
            case Range():
                return [self.builder.const(v) for v in self._range(tree)]
            case Call(function, args):
                return self._call(function, args)
            case Text(value):
                raise self.fail(f"the string {value!r} in an expression")
        raise self.fail(_show(tree))

    def _reference(self, name: str, subscripts: tuple[Expression, ...]) -> Value:
        if name not in self.values:
            raise self.fail(f"the name {name!r}, which is not declared as a number")
        found = self.values[name]
        for s in subscripts:
            index = self.integer(s)
            if not isinstance(found, list) or not 1 <= index <= len(found):
                raise self.fail(f"the subscript {index} of {name!r}")
            found = found[index - 1]
        return found

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
            if function in ("*", "/", "^") and all(isinstance(v, list) for v in values):
                if function != "*" or any(isinstance(x, list) for v in values for x in v):  # type: ignore[union-attr]
                    raise self.fail(f"the matrix operation {function!r}")
                return self._sum(self._elementwise("mul", values[0], values[1]))
            return self._elementwise(op, values[0], values[1])
        raise self.fail(f"{function!r} with {len(args)} arguments")

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
        node = self.scalar(tree)
        if node.op == "const" or self.builder.symbol(node.name) is not node:
            raise self.fail(f"der({_show(tree)}), the derivative of a parameter or constant")
        derivative = self.builder.symbol(f"der({node.name})")
        self.derivatives[node.name] = derivative
        return derivative

    def _array_function(self, function: str, args: tuple[Expression, ...]) -> Value | None:
        if function == "size":
            value = self.value(args[0])
            for _ in range(self.integer(args[1]) - 1 if len(args) > 1 else 0):
                value = value[0] if isinstance(value, list) else value
            if not isinstance(value, list):
                raise self.fail(f"size() of a number ({_show(args[0])})")
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
        flat = _flatten(value)
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
        for n in _flatten(value):
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
        inner = _Scope(self.builder, self.functions, {}, f"function {function.name}")
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


def _flatten(value: Value) -> list[Node]:
    if isinstance(value, list):
        return [n for v in value for n in _flatten(v)]
    return [value]


def _show(tree: Expression) -> str:
    match tree:
        case Name(name, subscripts):
            return name + (f"[{','.join(map(_show, subscripts))}]" if subscripts else "")
        case Number(value):
            return f"{value:g}"
        case Call(function, args):
            return f"{function}({', '.join(map(_show, args))})"
    return type(tree).__name__.lower()


def translate(model: FlatModel) -> System:
    """Turn a flat model into residuals over symbols.

    Raises
    ------
    InputError
        For a construct that has no translation; the message names it.
    """
    builder = Builder()
    time = builder.symbol("time")
    scope = _Scope(builder, model.functions, {"time": time}, f"model {model.name}")
    constants = [d for d in model.declarations if d.prefixes & {"parameter", "constant"}]
    others = [d for d in model.declarations if not d.prefixes & {"parameter", "constant"}]
    for d in others:
        if d.type != "Real":
            raise scope.fail(f"the variable {d.name!r} of type {d.type}")
        if "discrete" in d.prefixes:
            raise scope.fail(f"the discrete variable {d.name!r}")
        sizes = [scope.integer(s) for s in d.sizes]
        scope.values[d.name] = _symbols(builder, d.name, sizes)
    parameters = _parameters(scope, constants)
    variables: list[Variable] = []
    inputs: list[Variable] = []
    for d in others:
        for variable in _scalars(scope, d, None):
            (inputs if "input" in d.prefixes and "." not in d.name else variables).append(variable)
    residuals = [scope._elementwise("sub", scope.value(right), scope.value(left)) for left, right in model.equations]
    for d in others:
        if d.binding is not None:
            residuals.append(scope._elementwise("sub", scope.value(d.binding), scope.values[d.name]))
    initial = [scope._elementwise("sub", scope.value(r), scope.value(s)) for s, r in model.initial_equations]
    return System(
        model.name,
        builder,
        time,
        tuple(parameters),
        tuple(inputs),
        tuple(variables),
        tuple(n for r in residuals for n in _flatten(r)),
        tuple(n for r in initial for n in _flatten(r)),
        scope.derivatives,
    )


def _symbols(builder: Builder, name: str, sizes: Sequence[int]) -> Value:
    if not sizes:
        return builder.symbol(name)

    def level(prefix: tuple[int, ...]) -> Value:
        if len(prefix) == len(sizes):
            return builder.symbol(f"{name}[{','.join(map(str, prefix))}]")
        return [level((*prefix, i + 1)) for i in range(sizes[len(prefix)])]

    return level(())


def _names(name: str, sizes: Sequence[int]) -> list[str]:
    if not sizes:
        return [name]
    return [f"{name}[{','.join(map(str, i))}]" for i in product(*(range(1, s + 1) for s in sizes))]


def _parameters(scope: _Scope, declarations: Sequence[Declaration]) -> list[Variable]:
    """Declare parameters and constants in order of dependence; a literal binding makes an independent parameter."""
    waiting = list(declarations)
    found: dict[str, list[Variable]] = {}
    while waiting:
        stuck: list[Declaration] = []
        why: InputError | None = None
        for d in waiting:
            try:
                found[d.name] = _parameter(scope, d)
            except InputError as error:
                stuck.append(d)
                why = why or error
        if len(stuck) == len(waiting) and why is not None:
            raise why
        waiting = stuck
    return [v for d in declarations for v in found[d.name]]


def _parameter(scope: _Scope, d: Declaration) -> list[Variable]:
    if "fixed" in d.attributes and scope.scalar(d.attributes["fixed"]) is scope.builder.zero:
        raise scope.fail(f"the parameter {d.name!r} with fixed=false")
    if d.type == "String":
        return []
    binding = d.binding if d.binding is not None else d.attributes.get("start")
    if binding is None:
        raise scope.fail(f"the parameter {d.name!r} without a value")
    value = scope.value(binding)
    names = _names(d.name, [scope.integer(s) for s in d.sizes])
    nodes = _flatten(value)
    if len(nodes) == 1:
        nodes = nodes * len(names)
    if len(nodes) != len(names):
        raise scope.fail(f"the value of {d.name!r}, which does not have its size")
    variables = []
    symbols: list[Node] = []
    for variable, node in zip(_scalars(scope, d, nodes), nodes, strict=True):
        free = d.type == "Real" and "constant" not in d.prefixes and node.op == "const"
        symbols.append(scope.builder.symbol(variable.name) if free else node)
        variables.append(variable)
    scope.values[d.name] = _reshape(symbols, value, bool(d.sizes))
    return variables


def _reshape(nodes: list[Node], like: Value, array: bool) -> Value:
    if not array:
        return nodes[0]
    remaining = iter(nodes)

    def build(value: Value) -> Value:
        return [build(v) for v in value] if isinstance(value, list) else next(remaining)

    return build(like) if isinstance(like, list) else list(nodes)


def _scalars(scope: _Scope, d: Declaration, bindings: Sequence[Node] | None) -> list[Variable]:
    names = _names(d.name, [scope.integer(s) for s in d.sizes])
    attributes: dict[str, list[Node]] = {}
    unit = ""
    for key, tree in d.attributes.items():
        if isinstance(tree, Text):
            unit = tree.value if key == "unit" else unit
        elif key in ("start", "stateSelect") and (bindings is not None or key == "stateSelect"):
            continue
        else:
            nodes = _flatten(scope.value(tree))
            attributes[key] = nodes if len(nodes) == len(names) else [nodes[0]] * len(names)
    variables = []
    for i, name in enumerate(names):
        own = {k: v[i] for k, v in attributes.items()}
        fixed = own.pop("fixed", scope.builder.zero) is scope.builder.one
        binding = bindings[i] if bindings is not None else None
        variables.append(Variable(name, d.prefixes, d.type, d.description, unit, own, fixed, binding))
    return variables
