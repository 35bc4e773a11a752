"""Builds one flat model from others without a compiler: pure functions, milliseconds each."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import cast

from aero_bayes.errors import InputError
from aero_bayes.modelica.array_values import Value, scalars
from aero_bayes.modelica.expression import Builder
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable, element_names
from aero_bayes.modelica.scope import Scope
from aero_bayes.modelica.syntax import (
    Array,
    Call,
    Expression,
    Index,
    Name,
    Number,
    Statement,
    WhenStatement,
    map_names,
    map_names_in_statement,
    names_in,
    parse_reference,
)

_DEFAULTS = {"min": -math.inf, "max": math.inf, "nominal": 1.0, "start": 0.0, "fixed": 0.0}

#: Suffixes of names: of the true value that an output with a measurement law had before, and of the input that acts on
#: the model behind an input law.
TRUE_SUFFIX, ACTING_SUFFIX = "_true", "_acting"


def equate(flat: FlatModel, name: str, expression: Expression) -> FlatModel:
    """Add the equation ``name = expression``, ``x[1]`` for an element; the last one of the result."""
    left = parse_reference(name)
    flat.variable(left.name)
    return replace(flat, equations=(*flat.equations, FlatEquation(left, expression, "added")))


def add_input(flat: FlatModel, name: str, unit: str = "", description: str = "") -> FlatModel:
    """Add an input of the whole model."""
    if "." in name:
        raise InputError(f"the input {name!r}: an input of the whole model has a name without dots")
    given = {"start": Number(0.0)}
    return _with(flat, FlatVariable(name, causality="input", unit=unit, description=description, attributes=given))


def add_output(flat: FlatModel, name: str, expression: Expression, unit: str = "", description: str = "") -> FlatModel:
    """Add an output of the whole model that is ``expression``."""
    wider = _with(flat, FlatVariable(name, causality="output", unit=unit, description=description))
    return equate(wider, name, expression)


def set_parameter(flat: FlatModel, name: str, value: float | Expression) -> FlatModel:
    """Give a parameter another value. Raises InputError for a name that is no parameter."""
    if not any(v.name == name and v.variability == "parameter" for v in flat.variables):
        raise InputError(f"{flat.name}: no parameter {name!r}")
    new = tuple(replace(v, binding=_tree(value)) if v.name == name else v for v in flat.variables)
    return replace(flat, variables=new)


def set_elements(flat: FlatModel, values: Mapping[str, float]) -> FlatModel:
    """Give parameters other values, by name; of an array each element has its own name (``c[2]``).

    Raises InputError for an array of which some elements are not given."""
    for v in flat.variables:
        names = element_names(v.name, v.sizes)
        if given := [name for name in names if name in values]:
            if len(given) < len(names):
                raise InputError(f"{flat.name}: {v.name!r} is set as a whole, and some of its elements follow others")
            items = iter([values[name] for name in names])
            flat = set_parameter(flat, v.name, _nested(v.sizes, items))
        elif v.name in values:
            flat = set_parameter(flat, v.name, values[v.name])
    return flat


def _nested(sizes: Sequence[int], items: Iterator[float]) -> Expression:
    """Return the next items as an array of these sizes."""
    if not sizes:
        return Number(float(next(items)))
    return Array(tuple(_nested(sizes[1:], items) for _ in range(sizes[0])))


def add_term(flat: FlatModel, equation_index: int, expression: Expression) -> FlatModel:
    """Add ``expression`` to the residual ``left - right`` of an equation, by its index in ``flat.equations``."""
    e = flat.equations[equation_index]
    added = replace(e, left=Call("+", (e.left, expression)))
    return replace(flat, equations=(*flat.equations[:equation_index], added, *flat.equations[equation_index + 1 :]))


def replace_uses(flat: FlatModel, name: str, by: Expression, keep_equations: Collection[int] = ()) -> FlatModel:
    """Use an expression wherever equations, algorithms and events use a variable, also under ``der``.

    What
    an algorithm or a when clause assigns stays too. An element ``x[1]`` is one where it is named so."""
    old = parse_reference(name)

    def change(n: Name) -> Expression:
        if n == old and n.subscripts:
            return by
        if n.name != name:
            return n
        if not n.subscripts:
            return by
        return Name(by.name, n.subscripts) if isinstance(by, Name) and not by.subscripts else Index(by, n.subscripts)

    changed = _changed(flat, change)
    kept = set(keep_equations)
    equations = tuple(
        old if i in kept else new for i, (old, new) in enumerate(zip(flat.equations, changed.equations, strict=True))
    )
    return replace(changed, equations=equations)


def attribute_value(flat: FlatModel, name: str, attribute: str, values: Mapping[str, float] | None = None) -> float:
    """Return a number of a parameter or variable, with other ``values`` of parameters."""
    known = {v.name: v for v in flat.variables}
    element = parse_reference(name)
    v = known.get(name) or known.get(element.name)
    if v is None:
        raise InputError(f"{flat.name}: no variable {name!r}")
    tree = v.value if attribute == "value" else v.attributes.get(attribute)
    if tree is None:
        if attribute not in _DEFAULTS:
            raise InputError(f"{flat.name}: {name!r} has no {attribute}")
        return _DEFAULTS[attribute]
    found = _evaluated(flat, name, attribute, tree, values or {})
    for k in element.subscripts if v.name != name else ():
        if isinstance(found, list) and isinstance(k, Number):
            found = found[int(k.value) - 1]
    items = scalars(found)
    if len(items) != 1 or items[0].op != "const":
        raise InputError(f"{flat.name}: {attribute} of {name!r} is not one number")
    return items[0].value


def _evaluated(flat: FlatModel, name: str, attribute: str, tree: Expression, values: Mapping[str, float]) -> Value:
    """Evaluate an attribute after everything that it depends on."""
    known = {v.name: v for v in flat.variables}
    b = Builder()
    start: dict[str, Value] = {n: b.const(x) for n, x in values.items()}
    scope = Scope(b, flat.functions, start, f"{name}.{attribute}", records=flat.records)
    open_: set[str] = set()

    def need(expression: Expression) -> None:
        for n in names_in(expression):
            if n in scope.values or n not in known:
                continue
            binding = known[n].value
            if not known[n].constant or binding is None or n in open_:
                raise InputError(
                    f"{flat.name}: {attribute} of {name!r} depends on {n!r}, which has no value of its own"
                )
            open_.add(n)
            need(binding)
            scope.values[n] = scope.value(binding)

    need(tree)
    return scope.value(tree)


def _tree(value: float | Expression) -> Expression:
    return Number(float(value)) if isinstance(value, (int, float)) else value


def _with(flat: FlatModel, v: FlatVariable) -> FlatModel:
    if any(x.name == v.name for x in flat.variables):
        raise InputError(f"{flat.name}: there is a variable {v.name!r} already")
    return replace(flat, variables=(*flat.variables, v))


def _changed(flat: FlatModel, change: Callable[[Name], Expression]) -> FlatModel:
    """Equations, algorithms and events with every name changed; declarations, and what is assigned, as they are."""

    def both(e: FlatEquation) -> FlatEquation:
        left, right = map_names(e.left, change), map_names(e.right, change)
        return e if left == e.left and right == e.right else replace(e, left=left, right=right)

    def statements(body: tuple[Statement, ...]) -> tuple[Statement, ...]:
        return tuple(map_names_in_statement(s, change) for s in body)

    return replace(
        flat,
        equations=tuple(map(both, flat.equations)),
        initial_equations=tuple(map(both, flat.initial_equations)),
        algorithms=tuple(replace(a, statements=statements(a.statements)) for a in flat.algorithms),
        initial_algorithms=tuple(replace(a, statements=statements(a.statements)) for a in flat.initial_algorithms),
        whens=tuple(replace(w, statement=cast(WhenStatement, statements((w.statement,))[0])) for w in flat.whens),
        assertions=tuple(replace(a, condition=map_names(a.condition, change)) for a in flat.assertions),
    )
