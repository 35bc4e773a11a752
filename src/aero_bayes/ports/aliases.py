"""What equals what in a flat model, what is the derivative of what, and which variables are states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise

from aero_bayes.errors import InputError
from aero_bayes.export.compose import attribute_value
from aero_bayes.export.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.language.syntax import Call, Expression, Name, Number, names_in, summands, walk
from aero_bayes.ports.common_motion import SignedRepresentatives, SignedUnionFind, distances, moving_together
from aero_bayes.ports.scalar_equations import Origin, scalarised


@dataclass(frozen=True)
class AliasStructure:
    """Classes of equal variables; each is named by one of its members.

    ``same`` maps a variable to its class and sign, ``rates`` a class to that of its derivative where it has one,
    ``states`` are the classes whose derivative occurs, in the order of their declaration. ``plain`` are the equations
    that only say that two variables are equal or one the other's derivative. ``flat`` has the rows of vector equations
    as equations of their own, ``origins`` says where each is from. ``moving`` says what moves together,
    ``apart`` what the distance of two others is. ``units`` has that of a class where none is declared but one is for
    what it is added to or subtracted from.
    """

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
        """Class of a variable; the name itself where nothing equals it."""
        return self.same.get(name, (name, 1))[0]

    def members(self, cls: str) -> list[str]:
        """Variables that are equal to one, without a change of sign."""
        own = self.same.get(cls, (cls, 1))[1]
        return [n for n, (c, sign) in self.same.items() if c == cls and sign == own] or [cls]

    def states_in(self, tree: Expression) -> Iterator[str]:
        """The states of an expression, each once."""
        seen = {self.of(n) for n in names_in(tree)}
        yield from (s for s in self.states if s in seen)


def is_derivative(tree: Expression) -> str | None:
    """The name under ``der`` where a tree is a derivative of a plain variable."""
    match tree:
        case Call("der", (Name(name, ()),)):
            return name
    return None


def alias_structure(flat: FlatModel) -> AliasStructure:
    """Find the classes of equal variables and the states of a flat model."""
    flat, origins = scalarised(flat)
    variables = {v.name: v for v in flat.variables}
    free = {n for n, v in variables.items() if not v.constant and not v.sizes and v.type == "Real"}
    equal = SignedUnionFind()
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
                # all rates of what moves together are equal, whoever names them
                if sign > 0:
                    own.setdefault(state, two.name)
                unite(first.setdefault(moving[derived], two.name), two.name, 1)
    same = {n: equal.find(n) for n in variables if n in free}
    rates = {state: equal.find(rate)[0] for state, rate in own.items()}
    rest = [e for i, e in enumerate(flat.equations) if i not in plain]
    used = {equal.find(n)[0] for e in rest for n in names_in(e.left) | names_in(e.right) if n in free}
    driven = {equal.find(n)[0] for e in rest for n in derived_in(e) if n in free}
    # a rate whose own rate is only given a name is no state
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
    """A variable of the model's own that an equation gives by two states or more: its derivative says nothing new."""
    for one, whole in ((e.left, e.right), (e.right, e.left)):
        if isinstance(one, Name) and one.name in same and "." not in one.name and same[one.name][0] in states:
            given = same[one.name][0]
            varying = {n for n in names_in(whole) if n in variables and not variables[n].constant}
            others = {same.get(n, (n, 1))[0] for n in varying} - {given}
            if len(others) > 1 and others <= states and not [*derived_names(whole)]:
                return given
    return None


def _units_by_sums(flat: FlatModel, of: Mapping[str, str]) -> dict[str, str]:
    """The one unit that is declared for any of what is added up, for all of it."""
    group = SignedUnionFind()
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
    """A product without its factor, where that is a parameter which is one: the gain of a block that integrates."""
    match tree:
        case Call("*", (Name(gain, ()), Name() as inner)):
            v = variables.get(gain)
            if v is not None and v.constant and not v.sizes and v.type == "Real":
                with suppress(InputError):
                    return inner if attribute_value(flat, gain, "value") == 1.0 else tree
    return tree


def derived_in(e: FlatEquation) -> list[str]:
    """What is derived by time anywhere in an equation."""
    return [*derived_names(e.left), *derived_names(e.right)]


def derived_names(tree: Expression) -> Iterator[str]:
    """What is derived by time anywhere in an expression."""
    return (name for t in walk(tree) if (name := is_derivative(t)) is not None)


def _equal(e: FlatEquation) -> tuple[str, str, int] | None:
    """Two names and their relative sign, for ``a = b``, ``a = -b``, ``a + b = 0``, ``a - b = 0``."""
    match e.left, e.right:
        case Name(a, ()), Name(b, ()):
            return a, b, 1
        case (Name(a, ()), Call("neg", (Name(b, ()),))) | (Call("neg", (Name(a, ()),)), Name(b, ())):
            return a, b, -1
        case Call("+" | "-" as operator, (Name(a, ()), Name(b, ()))), Number(0.0):
            return a, b, -1 if operator == "+" else 1
    return None


def _rank(v: FlatVariable, dynamic: set[str]) -> tuple[bool, bool, bool, bool, int]:
    """The best name of a class: an input, else a declared state of the model itself rather than of a connector."""
    started = "fixed" in v.attributes
    return (v.causality != "input" or "." in v.name, v.name not in dynamic, not started, v.flow, v.name.count("."))
