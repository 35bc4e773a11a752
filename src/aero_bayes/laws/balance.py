"""A port: a place in a model where a term may be missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Self

from aero_bayes.errors import InputError
from aero_bayes.laws.aliases import derived_names, substituted
from aero_bayes.laws.insertion_point import Driver, InsertionPoint, RowIndex, element_of_row, find_insertion_point
from aero_bayes.modelica.compose import attribute_value
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.parse import SourceLocation, parse_text
from aero_bayes.modelica.syntax import (
    Array,
    Call,
    Expression,
    Name,
    Number,
    map_names,
    modelica_text,
    parse_reference,
    short_text,
    summands,
    walk,
)
from aero_bayes.modelica.units import Dimension, dimension_of_unit, unit_text, without_angle

#: Placeholder of the additional term in the residual of a vector equation.
TERM = Name("")


@dataclass(frozen=True)
class Signal:
    """What a law reads: a variable of a model, the difference of two, or the load at a balance, which is a formula."""

    expression: Expression

    @classmethod
    def of(cls, name: str, minus: str = "") -> Self:
        """Return the signal that is a variable, or its difference to another one."""
        own = parse_reference(name)
        return cls(Call("-", (own, parse_reference(minus))) if minus else own)

    @property
    def parts(self) -> tuple[tuple[int, Signal], ...]:
        """The variables that it adds up, with their signs; itself where it is no sum of variables."""
        terms = summands(self.expression)
        return tuple((s, Signal(t)) for s, t in terms) if all(isinstance(t, Name) for _, t in terms) else ((1, self),)

    @property
    def first(self) -> str:
        """The variable, or the one from which another one is subtracted."""
        return str(self.parts[0][1])

    def __str__(self) -> str:
        return modelica_text(self.expression) or short_text(self.expression)


@dataclass(frozen=True)
class Balance:
    """A balance equation, and how an opposing term enters its residual ``left - right``.

    ``load`` is the sum of its other terms but for the driver; None where it is no plain formula."""

    equation: int
    scale: Expression
    unit: str = ""
    row: RowIndex | None = None
    beside: tuple[Expression, ...] = ()
    state: str = ""
    force: str = ""
    sign: int = 1
    load: Signal | None = None

    def added(self, term: Expression) -> Expression:
        """Return the increment of the residual."""
        if self.row is None:
            return Call("*", (self.scale, term))
        return map_names(self.scale, lambda n: term if n == TERM else n)


def find_balance(
    flat: FlatModel,
    equation: int,
    driver: Driver,
    values: Mapping[str, float],
    units: Mapping[str, str],
    row: RowIndex | None = None,
) -> Balance | None:
    """Return the balance that an equation is; None if the derivative does not occur in it, or not linearly."""
    e = flat.equations[equation]
    sides = e.left, e.right
    constants = frozenset(v.name for v in flat.variables if v.constant)
    entry = find_insertion_point(sides, driver, constants=constants, values=values, row=row)
    if entry is None:
        return None
    if row is not None:
        items = element_of_row(sides[0], row), element_of_row(sides[1], row)
        # the terms of a side that is an array constructor are scalars
        numbers = {id(t) for side, item in zip(sides, items, strict=True) if item is not side for t in walk(item)}
        one = _unit_vector(row, Number(1.0))
        beside = tuple(t if id(t) in numbers else Call("*", (one, t)) for t in entry.like)
        return _in_row(flat, equation, entry, row, _unit(entry, items, units), beside)
    scale: Expression = Number(float(entry.sign * entry.side))
    for operator, factor in entry.factors:
        scale = Call(operator, (scale, factor))
    return Balance(
        equation,
        map_names(scale, lambda n: parse_reference(n.name) if not n.subscripts else n),
        _unit(entry, sides, units),
        load=_sum_of(entry.rest(sides, driver, values)),
    )


def _sum_of(terms: Sequence[tuple[int, Expression]]) -> Signal | None:
    """Return signed terms as one formula, those that are added first; None where one is no plain formula."""
    texts = [(s, modelica_text(t, 2)) for s, t in sorted(terms, key=lambda term: -term[0]) if t != Number(0.0)]
    if any(text is None for _, text in texts) or any([*derived_names(t)] for _, t in terms):
        return None
    whole = "".join(f"{' + ' if sign > 0 else ' - '}{text}" for sign, text in texts).removeprefix(" + ").strip()
    return Signal(parse_text(whole)) if whole else None


def _in_row(
    flat: FlatModel, equation: int, entry: InsertionPoint, row: RowIndex, unit: str, beside: tuple[Expression, ...]
) -> Balance:
    e = flat.equations[equation]
    whole = e.left if entry.side > 0 else e.right
    if entry.row is None:
        # the side is written element by element
        item = whole.items[row[0] - 1] if isinstance(whole, Array) else whole
        scale = _unit_vector(row, substituted(item, entry.group, TERM))
    else:
        scale = substituted(whole, entry.group, _unit_vector(row, TERM))
    signed = scale if entry.sign * entry.side > 0 else Call("neg", (scale,))
    return Balance(equation, signed, unit, row, beside)


def _unit_vector(row: RowIndex, item: Expression) -> Expression:
    return Array(tuple(item if k + 1 == row[0] else Number(0.0) for k in range(row[1])))


def parameter_values(flat: FlatModel) -> dict[str, float]:
    """Return values of the parameters that can be evaluated."""
    found = {}
    for v in flat.variables:
        if v.constant and not v.sizes and v.type == "Real":
            try:
                found[v.name] = attribute_value(flat, v.name, "value")
            except InputError:
                continue
    return found


def _unit(entry: InsertionPoint, sides: tuple[Expression, Expression], units: Mapping[str, str]) -> str:
    """Return the unit of a term in the sum of an insertion point; a torque is in N.m, not in N.m.rad."""

    def unit_of(name: str) -> str:
        # elements of an array have its unit
        return units.get(name) or units.get(name.partition("[")[0], "")

    for term in entry.like:
        if isinstance(term, Name) and unit_of(short_text(term)):
            return unit_of(short_text(term))

    def of(name: str) -> Dimension | None:
        return dimension_of_unit(unit_of(name))

    found = entry.dimension(of, sides)
    if found is None:
        return ""
    mechanical = "kg" in found and "rad" in found
    return unit_text(without_angle(found) if mechanical else found)


PortKind = Literal["input", "output", "reading", "motion", "storage", "electrical"]


@dataclass(frozen=True)
class KindOfPort:
    """The name of the quantity to which something is added at a port of a kind, and the names of the signals there."""

    acts: str
    signals: tuple[str, ...]


PORT_KINDS: Mapping[PortKind, KindOfPort] = {
    "input": KindOfPort("u", ("u",)),
    "output": KindOfPort("u", ("u",)),
    "reading": KindOfPort("u", ("u",)),
    "motion": KindOfPort("f", ("v", "x")),
    "storage": KindOfPort("q", ("h",)),
    "electrical": KindOfPort("v", ("i",)),
}
Attachment = Literal["input", "output", "signal", "equation", "node", "series"]

#: Units of a temperature, with the absolute zero in each.
KELVIN: Mapping[str, float] = {"K": 0.0, "degC": -273.15, "Cel": -273.15}


@dataclass(frozen=True)
class Port:
    """A place in a model where a term may be missing."""

    id: str
    kind: PortKind
    attachment: Attachment
    unit: str
    units: Mapping[str, str]
    place: SourceLocation | None
    states: tuple[str, ...] = ()
    signals: Mapping[str, Signal] = field(default_factory=dict)
    balance: Balance | None = None
    connectors: tuple[str, ...] = ()
    flow: str = ""
    potential: str = ""
    neighbours: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()
    defining_equation: int | None = None
    counts: bool = False

    @property
    def acted_on(self) -> Signal | None:
        """The signal of which a law makes another one; None where a law is added to a balance."""
        return self.signals["u"] if self.attachment in ("input", "output", "signal") else None


def signal_port(
    kind: PortKind, attachment: Attachment, signal: str, unit: str, place: SourceLocation | None, **others: Any
) -> Port:
    """Return the port at a signal, of which a law makes another one in the same unit."""
    return Port(
        signal, kind, attachment, unit, {"u": unit, "y": unit}, place, signals={"u": Signal.of(signal)}, **others
    )


#: The signal of a motion that is the rest of its balance: the force that drives it.
LOAD = "load"


def port_table(ports: Sequence[Port]) -> list[dict[str, object]]:
    """Return the ports as rows for a table or JSON: id, kind, unit, file, line, states, laws."""
    return [
        {
            "id": p.id,
            "kind": p.kind,
            "unit": p.unit,
            "file": p.place.file if p.place else "",
            "line": p.place.line if p.place else 0,
            "states": list(p.states),
            "laws": list(p.laws),
        }
        for p in ports
    ]
