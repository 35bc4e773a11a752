"""The standard library's one-dimensional tables as expressions: what its C functions interpolate, without them."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.export.arrays import Record, ShapeError, Value, numbers
from aero_bayes.export.expression import Builder, Node

_CONSTRUCTOR = "Modelica.Blocks.Types.ExternalCombiTable1D"
_INTERNAL = "Modelica.Blocks.Tables.Internal."
_VALUES = ("getTable1DValue", "getTable1DValueNoDer", "getTable1DValueNoDer2")
_LINEAR, _STEPS = 1.0, 3.0
_HOLD, _PERIODIC = 1.0, 3.0


def is_table_type(name: str) -> bool:
    """Whether a parameter of that type holds a table."""
    return name.rpartition(".")[2] == _CONSTRUCTOR.rpartition(".")[2]


def call_table(b: Builder, function: str, args: Sequence[Value]) -> Value | None:
    """The value of a function of a table, or None for another function.

    Raises
    ------
    ShapeError
        For a table on a file, or a smoothness other than straight lines and steps.
    """
    if function == _CONSTRUCTOR:
        if args[0] != "NoName" or args[1] != "NoName":
            raise ShapeError("a table that is read from a file")
        return Record(("rows", "columns", "smoothness", "extrapolation"), args[2:6])
    name = function.removeprefix(_INTERNAL)
    if name == function or not args or not isinstance(args[0], Record):
        return None
    rows = args[0].field("rows")
    if not isinstance(rows, list):
        raise ShapeError("a table without rows")
    grid = [row[0] for row in rows if isinstance(row, list) and isinstance(row[0], Node)]
    if name == "getTable1DAbscissaUmin":
        return grid[0]
    if name == "getTable1DAbscissaUmax":
        return grid[-1]
    if name not in _VALUES:
        return None
    column, u = numbers(args[1])[0], numbers(args[2])[0]
    which = int(numbers(args[0].field("columns"))[int(column.value) - 1].value)
    values = [numbers(row)[which - 1] for row in rows]
    smoothness, beyond = (numbers(args[0].field(n))[0].value for n in ("smoothness", "extrapolation"))
    return _interpolated(b, grid, values, u, smoothness, beyond)


def _interpolated(b: Builder, x: Sequence[Node], y: Sequence[Node], u: Node, smoothness: float, beyond: float) -> Node:
    if smoothness not in (_LINEAR, _STEPS):
        raise ShapeError("a table that is smooth (only straight lines and steps are translated)")
    if len(x) == 1:
        return y[0]
    if beyond == _HOLD:
        u = b.binary("min", b.binary("max", u, x[0]), x[-1])
    elif beyond == _PERIODIC:
        period = b.sub(x[-1], x[0])
        u = b.sub(u, b.mul(b.unary("floor", b.div(b.sub(u, x[0]), period)), period))
    result = _piece(b, x, y, u, len(x) - 2, smoothness)
    for k in range(len(x) - 3, -1, -1):
        result = b.select(b.binary("lt", u, x[k + 1]), _piece(b, x, y, u, k, smoothness), result)
    return result


def _piece(b: Builder, x: Sequence[Node], y: Sequence[Node], u: Node, k: int, smoothness: float) -> Node:
    if smoothness == _STEPS:
        return y[k]
    slope = b.div(b.sub(y[k + 1], y[k]), b.sub(x[k + 1], x[k]))
    return b.add(y[k], b.mul(slope, b.sub(u, x[k])))
