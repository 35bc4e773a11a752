"""Operators, events and tables of Modelica as expressions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from aero_bayes.modelica import array_values
from aero_bayes.modelica.array_values import Record, ShapeError, Value, scalars
from aero_bayes.modelica.expression import Builder, Node
from aero_bayes.modelica.syntax import Expression, Number

_STRICT = {"lt": "lt", "ge": "lt", "gt": "gt", "le": "gt"}


@dataclass(frozen=True)
class Relation:
    """``symbol`` is 1 where ``difference`` is below zero (``below``) or above it."""

    symbol: Node
    difference: Node
    below: bool


@dataclass(frozen=True)
class Rounding:
    """``symbol`` is the floor of ``argument``."""

    symbol: Node
    argument: Node


@dataclass(frozen=True)
class PeriodicEvent:
    """``symbol`` is 1 in the events at ``start + k interval``, k = 0, 1, ..."""

    symbol: Node
    start: Node
    interval: Node


@dataclass
class Events:
    """Collects events while a model is translated; the symbols ``piecewise_constant`` change in events only."""

    builder: Builder
    piecewise_constant: set[Node] = field(default_factory=set)
    relations: dict[tuple[Node, bool], Relation] = field(default_factory=dict)
    roundings: dict[Node, Rounding] = field(default_factory=dict)
    samplings: dict[tuple[Node, Node], PeriodicEvent] = field(default_factory=dict)

    def constant_between(self, node: Node) -> bool:
        """Return whether an expression changes in events only."""
        return self.builder.symbols(node) <= self.piecewise_constant

    def new(self, name: str) -> Node:
        """Return a new symbol that changes in events only."""
        symbol = self.builder.symbol(name)
        self.piecewise_constant.add(symbol)
        return symbol

    def relation(self, op: str, left: Node, right: Node) -> Node:
        """Return the truth of ``left op right``, which changes in events only."""
        b = self.builder
        plain = b.binary(op, left, right)
        if op in ("eq", "ne") or self.constant_between(plain):
            return plain
        strict = _STRICT[op]
        key = (b.sub(left, right), strict == "lt")
        if key not in self.relations:
            self.relations[key] = Relation(self.new(f"relation#{len(self.relations)}"), *key)
        symbol = self.relations[key].symbol
        return symbol if op == strict else b.unary("not", symbol)

    def floor(self, argument: Node) -> Node:
        """Return the floor of an expression, which changes in events only."""
        if self.constant_between(argument):
            return self.builder.unary("floor", argument)
        if argument not in self.roundings:
            self.roundings[argument] = Rounding(self.new(f"floor#{len(self.roundings)}"), argument)
        return self.roundings[argument].symbol

    def sample(self, start: Node, interval: Node) -> Node:
        """Return the symbol of ``sample(start, interval)``; both in s."""
        key = (start, interval)
        if key not in self.samplings:
            self.samplings[key] = PeriodicEvent(self.new(f"sample#{len(self.samplings)}"), start, interval)
        return self.samplings[key].symbol

    def pre(self, variable: Node) -> Node:
        """Return the symbol of a discrete variable's value until the event."""
        return self.new(f"pre({variable.name})")

    @property
    def initial(self) -> Node:
        """The symbol that is 1 in the initial event only."""
        return self.new("initial()")


#: Operators that depend on time or make events.
EVENT_OPERATORS = frozenset(
    {"der", "pre", "edge", "change", "initial", "sample", "floor", "integer", "ceil", "div", "mod", "rem", "semiLinear"}
)


def number_in(value: Value) -> Node:
    """Return a value that has to be a number."""
    if not isinstance(value, Node):
        raise ShapeError("an array where a number is needed")
    return value


class Operators:
    """Applies operators to values."""

    def __init__(self, builder: Builder) -> None:
        self.builder = builder
        self.events: Events | None = None
        self.derivatives: dict[str, Node] = {}
        self.left_limits: dict[Node, Node] = {}

    def relation(self, op: str, left: Value, right: Value) -> Value:
        """``left op right``, element by element; texts can be equal or not."""
        if isinstance(left, str) and isinstance(right, str) and op in ("eq", "ne"):
            return self.builder.const(float((left == right) is (op == "eq")))
        if self.events is None:
            return array_values.elementwise(lambda a, b: self.builder.binary(op, a, b), left, right)
        events = self.events
        return array_values.elementwise(lambda a, b: events.relation(op, a, b), left, right)

    def call(self, function: str, args: Sequence[Value]) -> Value | None:
        """Return the value of one of :data:`EVENT_OPERATORS`, or None where it has other arguments.

        ``der`` goes by the chain rule down to the symbols ``der(x)``; ``pre`` of what is continuous is its left limit.
        Raises LookupError for what has no value here."""
        b, apply = self.builder, array_values.elementwise
        match function, args:
            case "der", (value,):
                return array_values.mapped(self._rate, value)
            case (("pre" | "edge" | "change"), (value,)):
                if self.events is None:
                    raise LookupError(f"{function}() outside of equations")
                before = array_values.mapped(self._pre, value)
                if function == "pre":
                    return before
                if function == "change":
                    return apply(lambda x, y: b.binary("ne", x, y), value, before)
                return apply(lambda x, y: b.binary("and", x, b.unary("not", y)), value, before)
            case "initial", ():
                return self.events.initial if self.events is not None else b.zero
            case "sample", (start, interval):
                if self.events is None:
                    raise LookupError("sample() outside of equations")
                return self.events.sample(number_in(start), number_in(interval))
            case (("floor" | "integer"), (value,)):
                return array_values.mapped(self._floor, value)
            case "ceil", (value,):
                return array_values.mapped(lambda x: b.neg(self._floor(b.neg(x))), value)
            case (("div" | "mod" | "rem"), (left, right)):
                return apply(lambda x, y: self._divide(function, x, y), left, right)
            case "semiLinear", (flow, up, down):
                positive = scalars(self.relation("ge", number_in(flow), b.zero))[0]
                return apply(b.mul, array_values.select(b, positive, up, down), number_in(flow))
        return None

    def _rate(self, node: Node) -> Node:
        b = self.builder
        if node.op == "symbol" and node.name != "time" and not self._is_piecewise_constant(node):
            derivative = b.symbol(f"der({node.name})")
            self.derivatives[node.name] = derivative
            return derivative
        result = b.zero
        for symbol in sorted(b.symbols(node), key=lambda s: s.index):
            slope = b.derivative(node, symbol)
            if symbol.name == "time":
                result = b.add(result, slope)
            elif slope is not b.zero and not self._is_piecewise_constant(symbol):
                result = b.add(result, b.mul(slope, self._rate(symbol)))
        return result

    def _is_piecewise_constant(self, symbol: Node) -> bool:
        return self.events is not None and symbol in self.events.piecewise_constant

    def _pre(self, node: Node) -> Node:
        if node.name.startswith("pre("):
            return node  # in an algorithm, before it assigns the variable
        if self.events is not None and self.events.constant_between(node):
            return self.events.pre(node) if node.op == "symbol" else node
        if node.op == "symbol":
            limit = self.builder.symbol(f"left({node.name})")
            self.left_limits[limit] = node
            return limit
        raise LookupError("pre() of something that is not a variable")

    def _floor(self, x: Node) -> Node:
        return self.builder.unary("floor", x) if self.events is None else self.events.floor(x)

    def _divide(self, op: str, x: Node, y: Node) -> Node:
        b = self.builder
        ratio = b.div(x, y)
        if op == "mod":
            return b.sub(x, b.mul(self._floor(ratio), y))
        sign = self.relation("ge", ratio, b.zero)
        down, up = self._floor(ratio), b.neg(self._floor(b.neg(ratio)))
        whole = b.select(sign, down, up) if isinstance(sign, Node) else down
        return whole if op == "div" else b.sub(x, b.mul(whole, y))


_TYPES = "Modelica.Blocks.Types."
#: For each kind of table the arguments of its constructor that count, by name.
_CONSTRUCTORS = {
    "ExternalCombiTable1D": {"rows": 2, "columns": 3, "smoothness": 4, "extrapolation": 5},
    "ExternalCombiTable2D": {"rows": 2, "smoothness": 3, "extrapolation": 4},
    "ExternalCombiTimeTable": {"rows": 2, "start": 3, "columns": 4, "smoothness": 5, "extrapolation": 6, "shift": 7},
}
#: Functions that search a table from the row of an argument on, and which argument.
_SEARCHES = {"Modelica.Blocks.Sources.TimeTable.getInterpolationCoefficients": 4}
_INTERNAL = "Modelica.Blocks.Tables.Internal."
_LINEAR, _STEPS = 1.0, 3.0
_HOLD, _PERIODIC = 1.0, 3.0


def is_table_type(name: str) -> bool:
    """Return whether a parameter of that type holds a table."""
    return name.rpartition(".")[2] in _CONSTRUCTORS


def is_table_function(name: str) -> bool:
    """Return whether :func:`call_table` may know a function."""
    return name.startswith((_INTERNAL, _TYPES))


def call_table(b: Builder, function: str, args: Sequence[Value], events: Events | None = None) -> Value | None:
    """Return the value of a function of a table, or None for another function.

    A table over time makes an event at each of its instants where ``events`` are given."""
    fields = _CONSTRUCTORS.get(function.removeprefix(_TYPES))
    if fields is not None:
        if args[0] != "NoName" or args[1] != "NoName":
            raise ShapeError("a table that is read from a file")
        return Record(tuple(fields), [args[k] for k in fields.values()])
    name = function.removeprefix(_INTERNAL)
    if name == function or not args or not isinstance(args[0], Record):
        return None
    table = args[0]
    rows = table.field("rows")
    if not isinstance(rows, list):
        raise ShapeError("a table without rows")
    first = [scalars(row)[0] for row in rows]
    if name.startswith("getTable2D"):
        return _surface(b, name, table, rows, first[1:], args)
    if name in ("getTable1DAbscissaUmin", "getTimeTableTmin"):
        return first[0]
    if name in ("getTable1DAbscissaUmax", "getTimeTableTmax"):
        return first[-1]
    if name == "getNextTimeEvent":
        return b.const(1e60)  # Modelica.Constants.inf; the relations of the value itself make the events
    if not name.startswith(("getTable1DValue", "getTimeTableValue")):
        return None
    column, u = scalars(args[1])[0], scalars(args[2])[0]
    which = int(scalars(table.field("columns"))[int(column.value) - 1].value)
    values = [scalars(row)[which - 1] for row in rows]
    if name.startswith("getTable1D"):
        return _interpolated(b, first, values, u, table, None)
    before = _less(b, u, scalars(table.field("start"))[0], events)
    found = _interpolated(b, first, values, b.sub(u, scalars(table.field("shift"))[0]), table, events)
    return b.select(before, b.zero, found)


def with_search_from_first_row(function: str, args: tuple[Expression, ...]) -> tuple[Expression, ...]:
    """Let the search for a row of ``TimeTable`` start at the first one and not at the last found.

    It finds the same, and its number of turns is known."""
    at = _SEARCHES.get(function)
    return args if at is None or at >= len(args) else (*args[:at], Number(1.0), *args[at + 1 :])


def _surface(
    b: Builder, name: str, table: Record, rows: Sequence[Value], x: Sequence[Node], args: Sequence[Value]
) -> Value | None:
    """Return a table over two inputs: straight lines along the first one, then along the second."""
    across = scalars(rows[0])[1:]
    if name == "getTable2DAbscissaUmin":
        return [x[0], across[0]]
    if name == "getTable2DAbscissaUmax":
        return [x[-1], across[-1]]
    if not name.startswith("getTable2DValue"):
        return None
    u, v = (scalars(a)[0] for a in args[1:3])
    lines = [_interpolated(b, x, [scalars(row)[k + 1] for row in rows[1:]], u, table, None) for k in range(len(across))]
    return _interpolated(b, across, lines, v, table, None)


def _less(b: Builder, one: Node, other: Node, events: Events | None) -> Node:
    return b.binary("lt", one, other) if events is None else events.relation("lt", one, other)


def _interpolated(
    b: Builder, x: Sequence[Node], y: Sequence[Node], u: Node, table: Record, events: Events | None
) -> Node:
    smoothness, beyond = (scalars(table.field(n))[0].value for n in ("smoothness", "extrapolation"))
    if smoothness not in (_LINEAR, _STEPS):
        raise ShapeError("a table that is smooth (only straight lines and steps are translated)")
    if len(x) == 1:
        return y[0]
    if beyond == _PERIODIC:
        period = b.sub(x[-1], x[0])
        turns = b.div(b.sub(u, x[0]), period)
        u = b.sub(u, b.mul(b.unary("floor", turns) if events is None else events.floor(turns), period))
    elif beyond == _HOLD and events is None:
        u = b.binary("min", b.binary("max", u, x[0]), x[-1])
    result = _piece(b, x, y, u, len(x) - 2, smoothness)
    if beyond != _PERIODIC and (smoothness == _STEPS or (beyond == _HOLD and events is not None)):
        result = b.select(_less(b, u, x[-1], events), result, y[-1])
    for k in range(len(x) - 3, -1, -1):
        result = b.select(_less(b, u, x[k + 1], events), _piece(b, x, y, u, k, smoothness), result)
    if beyond == _HOLD and events is not None:
        result = b.select(_less(b, u, x[0], events), y[0], result)
    return result


def _piece(b: Builder, x: Sequence[Node], y: Sequence[Node], u: Node, k: int, smoothness: float) -> Node:
    if smoothness == _STEPS:
        return y[k]
    slope = b.div(b.sub(y[k + 1], y[k]), b.sub(x[k + 1], x[k]))
    return b.add(y[k], b.mul(slope, b.sub(u, x[k])))
