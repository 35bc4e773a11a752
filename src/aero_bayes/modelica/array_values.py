"""Numbers, arrays and records of expressions, and what Modelica's operators make of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Union

from aero_bayes.modelica.expression import Builder, Node

Value = Union[Node, str, "list[Value]"]


class Record(list["Value"]):
    """The fields of a record in order."""

    def __init__(self, names: Sequence[str], values: Iterable[Value]) -> None:
        super().__init__(values)
        self.names = tuple(names)

    def field(self, name: str) -> Value:
        """Raises ValueError where there is no such field."""
        return self[self.names.index(name)]


class ShapeError(ValueError):
    """Arrays that do not fit together; the message says how."""


def scalars(value: Value) -> list[Node]:
    """Return all numbers in order, row by row. A text has none."""
    if isinstance(value, list):
        return [n for v in value for n in scalars(v)]
    return [] if isinstance(value, str) else [value]


def shape(value: Value) -> tuple[int, ...]:
    """Sizes of an array along its dimensions; empty for a number or a record."""
    if not isinstance(value, list) or isinstance(value, Record):
        return ()
    return (len(value), *(shape(value[0]) if value else ()))


def filled(item: Value, sizes: Sequence[int]) -> Value:
    """Return an array of these sizes whose every element is `item`."""
    for size in reversed(sizes):
        item = [item] * size
    return item


def shaped(items: Iterator[Node], sizes: Sequence[int]) -> Value:
    """Return the next numbers as an array of these sizes, row by row."""
    return [shaped(items, sizes[1:]) for _ in range(sizes[0])] if sizes else next(items)


def elementwise(apply: Callable[[Node, Node], Node], a: Value, b: Value) -> Value:
    """Apply a scalar operation element by element; a number meets every element of an array."""
    if isinstance(a, str) or isinstance(b, str):
        raise ShapeError("text where a number is needed")
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            raise ShapeError(f"arrays of {len(a)} and {len(b)} elements")
        return [elementwise(apply, x, y) for x, y in zip(a, b, strict=True)]
    if isinstance(a, list):
        return [elementwise(apply, x, b) for x in a]
    if isinstance(b, list):
        return [elementwise(apply, a, y) for y in b]
    return apply(a, b)


def pairs(a: Value, b: Value) -> list[tuple[Node, Node]]:
    """Return the numbers of two arrays of one shape, two by two."""
    found: list[tuple[Node, Node]] = []

    def note(x: Node, y: Node) -> Node:
        found.append((x, y))
        return x

    elementwise(note, a, b)
    return found


def mapped(apply: Callable[[Node], Node], value: Value) -> Value:
    """Apply a function of one number to every element."""
    if isinstance(value, str):
        raise ShapeError("text where a number is needed")
    return [mapped(apply, v) for v in value] if isinstance(value, list) else apply(value)


def total(b: Builder, value: Value) -> Node:
    """Return the sum of all elements."""
    result = b.zero
    for n in scalars(value):
        result = b.add(result, n)
    return result


def product(b: Builder, left: list[Value], right: list[Value]) -> Value:
    """Vector or matrix product."""
    if left and isinstance(left[0], list):
        return [product(b, row, right) for row in left if isinstance(row, list)]
    if right and isinstance(right[0], list):
        columns = [[row[j] for row in right if isinstance(row, list)] for j in range(len(right[0]))]
        return [product(b, left, column) for column in columns]
    return total(b, elementwise(b.mul, left, right))


def select(b: Builder, condition: Node, then: Value, otherwise: Value) -> Value:
    """`then` where the condition holds, else `otherwise`, element by element."""
    if condition.op == "const":
        return then if condition.value else otherwise
    if isinstance(then, list) and isinstance(otherwise, list) and len(then) == len(otherwise):
        return [select(b, condition, x, y) for x, y in zip(then, otherwise, strict=True)]
    if isinstance(then, Node) and isinstance(otherwise, Node):
        return b.select(condition, then, otherwise)
    if then == otherwise:
        return then
    raise ShapeError("an if with branches of different size")


def concatenated(items: Sequence[Value], dimension: int) -> Value:
    """``[a, b]`` (dimension 1) or ``[a; b]`` (dimension 0) of numbers, vectors (columns) and matrices."""
    matrices = [_matrix(v) for v in items]
    if dimension == 0:
        return [row for m in matrices for row in m]
    if len({len(m) for m in matrices}) > 1:
        raise ShapeError("matrices of different height side by side")
    return [[x for m in matrices for x in m[i]] for i in range(len(matrices[0]))]


def _matrix(value: Value) -> list[list[Value]]:
    if not isinstance(value, list):
        return [[value]]
    return [list(row) if isinstance(row, list) else [row] for row in value]


def element(b: Builder, items: list[Value], index: Node) -> Value:
    """Return the element at a subscript, which counts from one; one that is not constant selects
    between all elements."""
    if index.op != "const":
        chosen = items[-1]
        for k in range(len(items) - 1, 0, -1):
            chosen = select(b, b.binary("eq", index, b.const(float(k))), items[k - 1], chosen)
        return chosen
    if not index.value.is_integer() or not 1 <= index.value <= len(items):
        raise IndexError(f"{index.value:g}")
    return items[int(index.value) - 1]


def transposed(value: Value) -> Value:
    """Return the transpose of a matrix; a vector counts as a column."""
    rows = _matrix(value)
    return [[row[j] for row in rows] for j in range(len(rows[0]))] if rows else []


def replaced(value: Value, indices: Sequence[int], item: Value) -> Value:
    """Return a copy with one element exchanged; indices count from one."""
    if not indices:
        return item
    if not isinstance(value, list) or not 1 <= indices[0] <= len(value):
        raise ShapeError(f"the subscript {indices[0]}")
    copy = list(value)
    copy[indices[0] - 1] = replaced(copy[indices[0] - 1], indices[1:], item)
    return copy
