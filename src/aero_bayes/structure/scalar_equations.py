"""Scalarisation of a flat model: vector and matrix equations row by row."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from aero_bayes.errors import InputError
from aero_bayes.modelica.arrays import Value, filled, mapped, scalars
from aero_bayes.modelica.compose import element_names
from aero_bayes.modelica.expression import Builder, Node
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.modelica.scope import Scope, without_solve
from aero_bayes.modelica.syntax import Call, Expression, Name, Number, map_children, map_names, names_in, short_text

_SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "^"}
#: Largest number of operations of a row. Of a larger one, only its names are kept.
MAX_OPERATIONS = 1000

#: Index of the equation of a row, number of the row (from one; 0 for a scalar equation), and number of rows.
Origin = tuple[int, int, int]


def scalarised(flat: FlatModel) -> tuple[FlatModel, tuple[Origin, ...]]:
    """Return the model with scalar variables ``x[1]`` for the elements of arrays, and scalar equations."""
    whole = tuple((i, 0, 1) for i in range(len(flat.equations)))
    if not any(v.sizes for v in flat.variables):
        return flat, whole
    variables = tuple(w for v in flat.variables for w in (v, *_elements(v)))
    rows = _Rows(flat)
    found = [(e, origin) for i, equation in enumerate(flat.equations) for e, origin in rows.of(i, equation)]
    return replace(flat, variables=variables, equations=tuple(e for e, _ in found)), tuple(o for _, o in found)


def _elements(v: FlatVariable) -> list[FlatVariable]:
    return [replace(v, name=n, sizes=(), binding=None) for n in element_names(v.name, v.sizes)]


class _Rows:
    def __init__(self, flat: FlatModel) -> None:
        self.known = {v.name: v for v in flat.variables}
        values: dict[str, Value] = {}
        self.scope = Scope(Builder(), flat.functions, values, flat.name, records=flat.records)
        values["time"] = self.scope.builder.symbol("time")
        for v in flat.variables:
            if not v.sizes:
                values[v.name] = self.scope.builder.symbol(v.name)
        for v in flat.variables:
            # constants in array sizes and subscripts
            if v.constant and v.type != "Real" and not v.sizes and v.binding is not None:
                self._settle(v)

    def _settle(self, v: FlatVariable) -> None:
        try:
            value = self.scope.value(v.binding) if v.binding is not None else ""
        except InputError:
            return
        if isinstance(value, Node) and value.op == "const":
            self.scope.values[v.name] = value

    def _need(self, names: Iterable[str]) -> None:
        """Give arrays their symbols. Elements of parameter arrays that are numbers stay numbers."""
        for n in names:
            v = self.known.get(n)
            if v is None or not v.sizes or n in self.scope.values:
                continue
            b = self.scope.builder
            own = _shaped(map(b.symbol, element_names(n, v.sizes)), filled(b.zero, v.sizes))
            self.scope.values[n] = own
            if v.constant and v.binding is not None and names_in(v.binding):
                self._need(names_in(v.binding))
                try:
                    fixed = scalars(self.scope.value(v.binding))
                except InputError:
                    continue
                if len(fixed) == len(scalars(own)):
                    given = (f if f.op == "const" else o for f, o in zip(fixed, scalars(own), strict=True))
                    self.scope.values[n] = _shaped(given, own)

    def of(self, index: int, e: FlatEquation) -> list[tuple[FlatEquation, Origin]]:
        plain = replace(e, left=map_names(e.left, self._element), right=map_names(e.right, self._element))
        names = names_in(plain.left) | names_in(plain.right)
        if not any(n in self.known and self.known[n].sizes for n in names):
            return [(plain, (index, 0, 1))]
        self._need(names_in(e.left) | names_in(e.right))
        try:
            pairs = self.scope.sides([e])
            shaped = isinstance(self.scope.value(without_solve(e).left), list)
        except InputError:
            return [(plain, (index, 0, 1))]
        rows = [(self._tree(a), self._tree(b)) for a, b in pairs]
        return [
            (replace(e, left=a, right=b), (index, k + 1 if shaped else 0, len(rows))) for k, (a, b) in enumerate(rows)
        ]

    def _element(self, n: Name) -> Expression:
        """Return an array element as a scalar variable, if its subscripts are numbers."""
        v = self.known.get(n.name)
        if v is None or not n.subscripts or len(n.subscripts) != len(v.sizes):
            return Name(short_text(n)) if n.subscripts and all(isinstance(k, Number) for k in n.subscripts) else n
        found: list[str] = []
        for k in n.subscripts:
            try:
                value = self.scope.value(k) if isinstance(k, (Number, Name, Call)) else None
            except InputError:
                return n
            if not isinstance(value, Node) or value.op != "const":
                return n
            found.append(f"{value.value:g}")
        return Name(f"{n.name}[{','.join(found)}]")

    def _tree(self, node: Node) -> Expression:
        left = [MAX_OPERATIONS]

        def tree(n: Node) -> Expression:
            left[0] -= 1
            if n.op == "const":
                return Number(n.value)
            if n.op == "symbol":
                return Call("der", (Name(n.name[4:-1]),)) if n.name.startswith("der(") else Name(n.name)
            if left[0] < 0:
                symbols = sorted(self.scope.builder.symbols(n), key=lambda s: s.index)
                return Call("of", tuple(tree(s) for s in symbols))
            return Call(_SIGNS.get(n.op, n.op), tuple(map(tree, n.args)))

        return tree(node)


def _shaped(items: Iterable[Node], like: Value) -> Value:
    """Return nodes in the shape of an array."""
    rest = iter(items)
    return mapped(lambda _: next(rest), like)


def substituted(tree: Expression, old: Expression, new: Expression) -> Expression:
    """Return an expression in which one part, by identity, is substituted."""
    return new if tree is old else map_children(tree, lambda t: substituted(t, old, new))
