"""The standard library's tables as expressions: what its C functions interpolate, without them."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.export.arrays import Record, ShapeError, Value, scalars
from aero_bayes.export.events import Events
from aero_bayes.export.expression import Builder, Node
from aero_bayes.language.syntax import Expression, Number

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
