"""A port: a place in a model where a term may be missing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from aero_bayes.errors import InputError
from aero_bayes.modelica.classes import ClassText, ComponentDeclaration, SourceStatement, dotted_name
from aero_bayes.modelica.compose import attribute_value
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.parse import SourceLocation, find_outside, parse_text, split_outside
from aero_bayes.modelica.sources import SourceFile, Sources
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
from aero_bayes.structure.aliases import derived_names, substituted
from aero_bayes.structure.insertion_point import Driver, InsertionPoint, RowIndex, element_of_row, find_insertion_point

#: Placeholder of the additional term in the residual of a vector equation.
TERM = Name("")


@dataclass(frozen=True)
class Balance:
    """A balance equation, and how an opposing term enters its residual ``left - right``.

    ``load`` is the sum of its other terms but for the driver, as Modelica; empty where it is no plain formula."""

    equation: int
    scale: Expression
    unit: str = ""
    row: RowIndex | None = None
    beside: tuple[Expression, ...] = ()
    state: str = ""
    force: str = ""
    sign: int = 1
    load: str = ""

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


def _sum_of(terms: Sequence[tuple[int, Expression]]) -> str:
    """Return signed terms as one formula, those that are added first; empty where one is no plain formula."""
    texts = [(s, modelica_text(t, 2)) for s, t in sorted(terms, key=lambda term: -term[0]) if t != Number(0.0)]
    if any(text is None for _, text in texts) or any([*derived_names(t)] for _, t in terms):
        return ""
    return "".join(f"{' + ' if sign > 0 else ' - '}{text}" for sign, text in texts).removeprefix(" + ").strip()


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


@dataclass(frozen=True)
class CombinationRule:
    """How several laws are combined in one replaceable model.

    All laws get the inputs and parameters in ``handed``, and are connected in parallel at the connectors in ``shared``.
    They are connected in series at the two connectors in ``series``, or by the input and output in ``signal``."""

    handed: tuple[str, ...] = ()
    shared: tuple[str, ...] = ()
    series: tuple[str, str] | None = None
    signal: tuple[str, str] | None = None


@dataclass(frozen=True)
class ReplaceableModel:
    """A replaceable model of a system."""

    name: str
    description: str
    constraint: str
    default: str
    components: tuple[str, ...]
    place: SourceLocation
    combination: CombinationRule | None


def find_replaceable_models(known: Sources, model: str) -> tuple[ReplaceableModel, ...]:
    """Find replaceable models with components, of a model and the classes that it extends."""
    try:
        chain = known.lineage(*known.find(model))
    except InputError:
        return ()
    found: dict[str, ReplaceableModel] = {}
    for file, cls in chain:
        for statement in cls.statements:
            read = _declared(known, file, cls, statement)
            if read is not None and read.name not in found:
                found[read.name] = replace(read, components=tuple(_components(known, chain, read.name)))
    return tuple(one for one in found.values() if one.components)


def _declared(known: Sources, file: SourceFile, cls: ClassText, s: SourceStatement) -> ReplaceableModel | None:
    """Return a statement ``replaceable model Name = Default constrainedby Partial "description"``.

    None for any other."""
    words = [t.word for t in s.tokens]
    kind = next((k for k in ("model", "block") if k in words[:4]), "")
    if s.section != "class" or "replaceable" not in words[:3] or not kind:
        return None
    at = words.index(kind) + 1
    if words[at + 1 : at + 2] != ["="]:
        return None
    default = known.resolve(cls, dotted_name(s.tokens[at + 2 :])[0])
    limit = find_outside(s.tokens, frozenset({"constrainedby"}))
    constraint = known.resolve(cls, dotted_name(s.tokens[limit + 1 :])[0]) if limit < len(words) else default
    end = find_outside(s.tokens, frozenset({"annotation"}))
    description = "".join(t.word[1:-1] for t in s.tokens[:end] if t.kind == "text")
    before = file.text[: s.start]
    start, stop = len(before.encode()), len(file.text[: s.end].encode())
    place = SourceLocation(file.file, start, stop, before.count("\n") + 1)
    return ReplaceableModel(words[at], description, constraint, default, (), place, _join(known, constraint, default))


def _components(known: Sources, chain: Sequence[tuple[SourceFile, ClassText]], name: str) -> Iterator[str]:
    """Yield paths of the components of a replaceable model, also where it is passed on by a redeclaration."""
    for _, cls in reversed(chain):
        for c in cls.components():
            if c.type == name:
                yield c.name
            for inner in _passed(c, name):
                try:
                    deeper = known.lineage(*known.find(known.resolve(cls, c.type)))
                except InputError:
                    continue
                yield from (f"{c.name}.{path}" for path in _components(known, deeper, inner))


def _passed(c: ComponentDeclaration, name: str) -> list[str]:
    """Return replaceable models of the class of a component that are redeclared as ``name``."""
    parts = [[t.word for t in part] for part in split_outside(c.arguments[1:-1])]
    return [w[2] for w in parts if len(w) == 5 and w[0] == "redeclare" and w[3] == "=" and w[4] == name]


# combination of several laws


def _join(known: Sources, constraint: str, default: str) -> CombinationRule | None:
    """Return the rule that follows from the connectors and signals of the constraining class and the default class."""
    try:
        chain, there = (known.lineage(*known.find(name)) for name in (constraint, default))
    except InputError:
        return None
    neutral = {" ".join(t.word for t in s.core) for _, cls in there for s in cls.equations}
    own = [(cls, c) for _, cls in chain for c in cls.components()]
    inputs = [c.name for _, c in own if c.prefixes & {"input", "parameter"} and "final" not in c.prefixes]
    outputs = [c.name for _, c in own if "output" in c.prefixes]
    ends = [(c.name, flow) for cls, c in own if (flow := _flow(known, cls, c))]
    shared = [name for name, flow in ends if f"{name} . {flow} = 0" in neutral]
    rest = [name for name, _ in ends if name not in shared]
    signal = next(((u, y) for u in inputs for y in outputs if f"{y} = {u}" in neutral), None)
    if len(rest) not in (0, 2) or len(outputs) > (signal is not None):
        return None
    handed = [name for name in inputs if signal is None or name != signal[0]]
    return CombinationRule(tuple(handed), tuple(shared), (rest[0], rest[1]) if rest else None, signal)


def _flow(known: Sources, cls: ClassText, c: ComponentDeclaration) -> str:
    """Return the name of the flow variable of a connector; empty for any other component."""
    try:
        chain = known.lineage(*known.find(known.resolve(cls, c.type)))
    except InputError:
        return ""
    return next(
        (v.name for _, of in chain if of.kind == "connector" for v in of.components() if "flow" in v.prefixes), ""
    )


PortKind = Literal["input", "output", "reading", "motion", "storage", "electrical", "replaceable"]
Attachment = Literal["input", "output", "signal", "equation", "node", "series", "redeclare"]

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
    signals: Mapping[str, str] = field(default_factory=dict)
    balance: Balance | None = None
    connectors: tuple[str, ...] = ()
    flow: str = ""
    potential: str = ""
    neighbours: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()
    defining_equation: int | None = None
    replaceable: ReplaceableModel | None = None
    counts: bool = False


def signal_port(
    kind: PortKind, attachment: Attachment, signal: str, unit: str, place: SourceLocation | None, **others: Any
) -> Port:
    """Return the port at a signal, of which a law makes another one in the same unit."""
    return Port(signal, kind, attachment, unit, {"u": unit, "y": unit}, place, signals={"u": signal}, **others)


#: Separates the two variables of a difference.
DIFFERENCE = " - "
#: The signal of a motion that is the rest of its balance: the force that drives it, by names in the model.
LOAD = "load"


def signal_expression(given: str) -> Expression:
    """Return the expression of a signal: a variable, the difference of two, or the load at a balance."""
    return parse_text(given)


def signal_parts(given: str) -> list[tuple[int, str]]:
    """Return the variables that a signal adds up, with their signs; itself where it is no sum of variables."""
    terms = summands(signal_expression(given))
    return [(s, short_text(t)) for s, t in terms] if all(isinstance(t, Name) for _, t in terms) else [(1, given)]


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
