"""Alias analysis of a flat model: scalar equations, equal variables, derivatives, and states."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise

from aero_bayes.errors import InputError
from aero_bayes.modelica.array_values import Value, scalars, shaped
from aero_bayes.modelica.compose import attribute_value
from aero_bayes.modelica.expression import Builder, Node
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable, element_names
from aero_bayes.modelica.graphs import SignedUnionFind
from aero_bayes.modelica.scope import Scope, without_solve
from aero_bayes.modelica.syntax import (
    Call,
    Expression,
    Name,
    Number,
    map_children,
    map_names,
    names_in,
    short_text,
    summands,
    walk,
)

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
    variables = tuple(
        w
        for v in flat.variables
        for w in (v, *(replace(v, name=n, sizes=(), binding=None) for n in element_names(v.name, v.sizes)))
    )
    rows = _Rows(flat)
    found = [(e, origin) for i, equation in enumerate(flat.equations) for e, origin in rows.of(i, equation)]
    return replace(flat, variables=variables, equations=tuple(e for e, _ in found)), tuple(o for _, o in found)


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
            own = shaped(map(b.symbol, v.scalar_names), v.sizes)
            self.scope.values[n] = own
            if v.constant and v.binding is not None and names_in(v.binding):
                self._need(names_in(v.binding))
                try:
                    fixed = scalars(self.scope.value(v.binding))
                except InputError:
                    continue
                if len(fixed) == len(scalars(own)):
                    given = (f if f.op == "const" else o for f, o in zip(fixed, scalars(own), strict=True))
                    self.scope.values[n] = shaped(given, v.sizes)

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


def substituted(tree: Expression, old: Expression, new: Expression) -> Expression:
    """Return an expression in which one part, by identity, is substituted."""
    return new if tree is old else map_children(tree, lambda t: substituted(t, old, new))


#: For each variable its representative and relative sign. The representative of a constant is the empty name.
SignedRepresentatives = Mapping[str, tuple[str, int]]


def moving_together(equations: Sequence[FlatEquation], free: Collection[str]) -> dict[str, tuple[str, int]]:
    """Find variables whose sum or difference is constant. ``free`` are the variables that are not constants."""
    known = SignedUnionFind[str]()
    sums = [s for e in equations if (s := _sum(e, free)) is not None]
    grown = True
    while grown:
        grown = False
        for terms in sums:
            left: dict[str, int] = {}
            for sign, name in terms:
                base, flip = known.find(name)
                left[base] = left.get(base, 0) + sign * flip
            moving = [(name, k) for name, k in left.items() if name and k]
            if len(moving) == 1:
                known.union(moving[0][0], "", 1)
                grown = True
            elif len(moving) == 2 and {abs(k) for _, k in moving} == {1}:
                (one, k), (two, m) = moving
                known.union(two, one, -k * m)
                grown = True
    return {name: known.find(name) for name in free}


def distances(equations: Sequence[FlatEquation], moving: SignedRepresentatives) -> dict[str, frozenset[str]]:
    """Return, for each variable that an equation defines as the difference or sum of two others, these two."""
    found: dict[str, frozenset[str]] = {}
    for e in equations:
        terms = _sum(e, moving.keys()) if isinstance(e.left, Name) else None
        if terms is not None and isinstance(e.left, Name):
            ends = frozenset(moving[name][0] for _, name in terms if name != e.left.name) - {""}
            if len(ends) == 2:
                found.setdefault(e.left.name, ends)
    return found


def _sum(e: FlatEquation, free: Collection[str]) -> list[tuple[int, str]] | None:
    """Return the variables of an equation with their signs, if it is a sum of variables and constants."""
    found: list[tuple[int, str]] = []
    for sign, tree in summands(Call("-", (e.left, e.right))):
        match tree:
            case Name(name, ()) if name in free:
                found.append((sign, name))
            case _ if names_in(tree) & {*free, "time"} or (isinstance(tree, Name) and tree.subscripts):
                return None
    return found


@dataclass(frozen=True)
class AliasStructure:
    """Classes of alias variables. Each class has the name of one of its members."""

    flat: FlatModel
    variables: dict[str, FlatVariable]
    same: dict[str, tuple[str, int]]
    rates: dict[str, str]
    states: tuple[str, ...]
    plain: frozenset[int]
    origins: tuple[Origin, ...] = ()
    moving: SignedRepresentatives = field(default_factory=dict)
    apart: dict[str, frozenset[str]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    def of(self, name: str) -> str:
        """Return class of a variable; its own name if it has no alias."""
        return self.same.get(name, (name, 1))[0]

    def members(self, cls: str) -> list[str]:
        """Return variables of a class that are equal to its representative with the same sign."""
        own = self.same.get(cls, (cls, 1))[1]
        return [n for n, (c, sign) in self.same.items() if c == cls and sign == own] or [cls]

    def states_in(self, tree: Expression) -> Iterator[str]:
        """Yield the states of an expression, each once."""
        seen = {self.of(n) for n in names_in(tree)}
        yield from (s for s in self.states if s in seen)


def is_derivative(tree: Expression) -> str | None:
    """Return the variable, if an expression is its derivative ``der(variable)``; else None."""
    match tree:
        case Call("der", (Name(name, ()),)):
            return name
    return None


def alias_structure(flat: FlatModel) -> AliasStructure:
    """Find the alias classes and the states of a flat model."""
    flat, origins = scalarised(flat)
    variables = {v.name: v for v in flat.variables}
    free = {n for n, v in variables.items() if not v.constant and not v.sizes and v.type == "Real"}
    equal = SignedUnionFind[str]()
    dynamic = {n for e in flat.equations for n in derived_in(e) if n in free}

    plain = set[int]()

    def unite(one: str, two: str, sign: int) -> None:
        (a, sign_a), (b, sign_b) = equal.find(one), equal.find(two)
        if a != b:
            kept, gone = sorted((a, b), key=lambda n: _rank(variables[n], dynamic))
            equal.union(gone, kept, sign_a * sign_b * sign)

    for i, e in enumerate(flat.equations):
        pair = _equal(e)
        if pair is not None and pair[0] in free and pair[1] in free:
            plain.add(i)
            unite(*pair)
    moving = moving_together(flat.equations, free)
    first: dict[tuple[str, int], str] = {}
    own: dict[str, str] = {}
    for i, e in enumerate(flat.equations):
        for one, whole in ((e.left, e.right), (e.right, e.left)):
            derived = is_derivative(one)
            two = _without_one(whole, flat, variables) if derived in free else whole
            if derived in free and isinstance(two, Name) and two.name in free and not two.subscripts:
                if variables[equal.find(two.name)[0]].causality == "input" and "." not in equal.find(two.name)[0]:
                    continue  # an integrator of an input: its balance
                plain.add(i)
                state, sign = equal.find(derived)
                # variables that differ by a constant have the same derivative
                if sign > 0:
                    own.setdefault(state, two.name)
                unite(first.setdefault(moving[derived], two.name), two.name, 1)
    same = {n: equal.find(n) for n in variables if n in free}
    rates = {state: equal.find(rate)[0] for state, rate in own.items()}
    rest = [e for i, e in enumerate(flat.equations) if i not in plain]
    used = {equal.find(n)[0] for e in rest for n in names_in(e.left) | names_in(e.right) if n in free}
    driven = {equal.find(n)[0] for e in rest for n in derived_in(e) if n in free}
    # a derivative whose own derivative is only named, and not used, is no state
    idle = {x for x, rate in rates.items() if x in rates.values() and x not in driven and rate not in used}
    found = {equal.find(n)[0] for n in dynamic} - idle
    found -= {x for e in rest if (x := _combined(e, variables, same, found))}
    states = tuple(v.name for v in flat.variables if v.name in found)
    return AliasStructure(
        flat, variables, same, rates, states, frozenset(plain), origins, moving, distances(flat.equations, moving),
        _units_by_sums(flat, {n: same.get(n, (n, 1))[0] for n in variables}),
    )  # fmt: skip


def _combined(
    e: FlatEquation, variables: Mapping[str, FlatVariable], same: SignedRepresentatives, states: Set[str]
) -> str | None:
    """Return a variable that an equation defines as a function of two or more states, so that it is no state itself."""
    for one, whole in ((e.left, e.right), (e.right, e.left)):
        if isinstance(one, Name) and one.name in same and "." not in one.name and same[one.name][0] in states:
            given = same[one.name][0]
            varying = {n for n in names_in(whole) if n in variables and not variables[n].constant}
            others = {same.get(n, (n, 1))[0] for n in varying} - {given}
            if len(others) > 1 and others <= states and not [*derived_names(whole)]:
                return given
    return None


def _units_by_sums(flat: FlatModel, of: Mapping[str, str]) -> dict[str, str]:
    """Return units of variables from the terms to which they are added, if all declared units there agree."""
    group = SignedUnionFind[str]()
    for e in flat.equations:
        for tree in walk(Call("-", (e.left, e.right))):
            names = (t.name for _, t in summands(tree) if isinstance(t, Name) and not t.subscripts)
            for one, two in pairwise(of[n] for n in names if n in of):
                (kept, _), (gone, _) = group.find(one), group.find(two)
                if gone != kept:
                    group.union(gone, kept, 1)
    declared: dict[str, set[str]] = {}
    for v in flat.variables:
        if v.unit:
            declared.setdefault(group.find(of[v.name])[0], set()).add(v.unit)
    return {cls: next(iter(u)) for cls in {*of.values()} if len(u := declared.get(group.find(cls)[0], set())) == 1}


def _without_one(tree: Expression, flat: FlatModel, variables: Mapping[str, FlatVariable]) -> Expression:
    """Leave out the first factor of a product if it is a parameter of value 1, such as an integrator's gain."""
    match tree:
        case Call("*", (Name(gain, ()), Name() as inner)):
            v = variables.get(gain)
            if v is not None and v.constant and not v.sizes and v.type == "Real":
                with suppress(InputError):
                    return inner if attribute_value(flat, gain, "value") == 1.0 else tree
    return tree


def derived_in(e: FlatEquation) -> list[str]:
    """Return names whose time derivative occurs in an equation."""
    return [*derived_names(e.left), *derived_names(e.right)]


def derived_names(tree: Expression) -> Iterator[str]:
    """Return names whose time derivative occurs in an expression."""
    return (name for t in walk(tree) if (name := is_derivative(t)) is not None)


def _equal(e: FlatEquation) -> tuple[str, str, int] | None:
    """Return two names and their relative sign, for ``a = b``, ``a = -b``, ``a + b = 0``, ``a - b = 0``."""
    match e.left, e.right:
        case Name(a, ()), Name(b, ()):
            return a, b, 1
        case (Name(a, ()), Call("neg", (Name(b, ()),))) | (Call("neg", (Name(a, ()),)), Name(b, ())):
            return a, b, -1
        case Call("+" | "-" as operator, (Name(a, ()), Name(b, ()))), Number(0.0):
            return a, b, -1 if operator == "+" else 1
    return None


def _rank(v: FlatVariable, dynamic: set[str]) -> tuple[bool, bool, bool, bool, int]:
    """Sort key for the name of a class: an input first, then a declared state of the model itself."""
    started = "fixed" in v.attributes
    return (v.causality != "input" or "." in v.name, v.name not in dynamic, not started, v.flow, v.name.count("."))
