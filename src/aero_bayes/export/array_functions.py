"""Modelica's functions of arrays: sizes, constructors, reductions."""

from __future__ import annotations

from functools import partial, reduce

from aero_bayes.export import arrays
from aero_bayes.export.arrays import ShapeError, Value, scalars
from aero_bayes.export.expression import Builder, Node

ARRAY_FUNCTIONS = frozenset(
    {"sum", "product", "min", "max", "size", "ndims", "fill", "zeros", "ones", "scalar", "vector", "matrix",
     "transpose", "identity", "diagonal", "linspace", "cross", "[,]", "[;]", "cat"}
)  # fmt: skip


def array_function(b: Builder, function: str, args: list[Value]) -> Value | None:
    """Return the value of a function of :data:`ARRAY_FUNCTIONS`, or None where it means the function of numbers."""

    match function, args:
        case "size", (value,):
            return [b.const(float(n)) for n in arrays.shape(value)]
        case "size", (value, dimension):
            sizes = arrays.shape(value)
            if not 1 <= _whole(dimension) <= len(sizes):
                raise ShapeError("size() of a dimension that is not there")
            return b.const(float(sizes[_whole(dimension) - 1]))
        case "ndims", (value,):
            return b.const(float(len(arrays.shape(value))))
        case "fill", (item, *sizes):
            return arrays.filled(item, [_whole(s) for s in sizes])
        case (("zeros" | "ones"), _):
            return arrays.filled(b.const(float(function == "ones")), [_whole(s) for s in args])
        case "identity", (size,):
            n = _whole(size)
            return [[b.const(float(i == j)) for j in range(n)] for i in range(n)]
        case "diagonal", (value,):
            items = scalars(value)
            return [[x if i == j else b.zero for j in range(len(items))] for i, x in enumerate(items)]
        case "linspace", (first, last, count):
            n = _whole(count)
            width = arrays.elementwise(b.sub, last, first)
            steps = [arrays.elementwise(b.mul, b.const(k / (n - 1)), width) for k in range(n)]
            return [arrays.elementwise(b.add, first, step) for step in steps]
        case "cross", (x, y):
            u, v = scalars(x), scalars(y)
            return [b.sub(b.mul(u[i], v[j]), b.mul(u[j], v[i])) for i, j in ((1, 2), (2, 0), (0, 1))]
        case "transpose", (value,):
            return arrays.transposed(value)
        case "[,]", _:
            return arrays.concatenated(args, 1)
        case "[;]", _:
            return arrays.concatenated(args, 0)
        case "sum", (value,):
            return arrays.total(b, value)
        case "vector", (value,):
            return list(scalars(value))
        case "matrix", (value,):
            return arrays.concatenated([value], 1)
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
