"""Flat model -> parameters, variables and residuals over the expression graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

from aero_bayes.errors import InputError
from aero_bayes.export.expression import Builder, Node
from aero_bayes.export.scope import Scope, Value, numbers
from aero_bayes.export.syntax import (
    Declaration,
    Equal,
    FlatModel,
    Name,
    Text,
)


@dataclass(frozen=True)
class Variable:
    """A scalar of the model: its name, its attributes as expressions, and where it is declared to act."""

    name: str
    prefixes: frozenset[str]
    type: str
    description: str
    unit: str
    attributes: Mapping[str, Node]
    fixed: bool
    binding: Node | None


@dataclass(frozen=True)
class System:
    """Residuals ``0 = r`` over symbols. ``der(x)`` is the symbol of that name; dependent parameters are resolved."""

    name: str
    builder: Builder
    time: Node
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    variables: tuple[Variable, ...]
    residuals: tuple[Node, ...]
    initial_residuals: tuple[Node, ...]
    derivatives: dict[str, Node] = field(default_factory=dict)


def translate(model: FlatModel) -> System:
    """Turn a flat model into residuals over symbols.

    Raises
    ------
    InputError
        For a construct that has no translation; the message names it.
    """
    builder = Builder()
    time = builder.symbol("time")
    scope = Scope(builder, model.functions, {"time": time}, f"model {model.name}")
    constants = [d for d in model.declarations if d.prefixes & {"parameter", "constant"}]
    others = [d for d in model.declarations if not d.prefixes & {"parameter", "constant"}]
    for d in others:
        if d.type != "Real":
            raise scope.fail(f"the variable {d.name!r} of type {d.type}")
        if "discrete" in d.prefixes:
            raise scope.fail(f"the discrete variable {d.name!r}")
        sizes = [scope.integer(s) for s in d.sizes]
        scope.values[d.name] = _symbols(builder, d.name, sizes)
    parameters = _parameters(scope, constants)
    variables: list[Variable] = []
    inputs: list[Variable] = []
    for d in others:
        for variable in _scalars(scope, d, None):
            (inputs if "input" in d.prefixes and "." not in d.name else variables).append(variable)
    residuals = scope.residuals(model.equations)
    residuals += scope.residuals([Equal(Name(d.name), d.binding) for d in others if d.binding is not None])
    initial = scope.residuals(model.initial_equations)
    return System(
        model.name,
        builder,
        time,
        tuple(parameters),
        tuple(inputs),
        tuple(variables),
        tuple(residuals),
        tuple(initial),
        scope.derivatives,
    )


def _symbols(builder: Builder, name: str, sizes: Sequence[int]) -> Value:
    if not sizes:
        return builder.symbol(name)

    def level(prefix: tuple[int, ...]) -> Value:
        if len(prefix) == len(sizes):
            return builder.symbol(f"{name}[{','.join(map(str, prefix))}]")
        return [level((*prefix, i + 1)) for i in range(sizes[len(prefix)])]

    return level(())


def _names(name: str, sizes: Sequence[int]) -> list[str]:
    if not sizes:
        return [name]
    return [f"{name}[{','.join(map(str, i))}]" for i in product(*(range(1, s + 1) for s in sizes))]


def _parameters(scope: Scope, declarations: Sequence[Declaration]) -> list[Variable]:
    """Declare parameters and constants in order of dependence; a literal binding makes an independent parameter."""
    waiting = list(declarations)
    found: dict[str, list[Variable]] = {}
    while waiting:
        stuck: list[Declaration] = []
        why: InputError | None = None
        for d in waiting:
            try:
                found[d.name] = _parameter(scope, d)
            except InputError as error:
                stuck.append(d)
                why = why or error
        if len(stuck) == len(waiting) and why is not None:
            raise why
        waiting = stuck
    return [v for d in declarations for v in found[d.name]]


def _parameter(scope: Scope, d: Declaration) -> list[Variable]:
    if "fixed" in d.attributes and scope.scalar(d.attributes["fixed"]) is scope.builder.zero:
        raise scope.fail(f"the parameter {d.name!r} with fixed=false")
    if d.type == "String":
        return []
    binding = d.binding if d.binding is not None else d.attributes.get("start")
    if binding is None:
        raise scope.fail(f"the parameter {d.name!r} without a value")
    value = scope.value(binding)
    names = _names(d.name, [scope.integer(s) for s in d.sizes])
    nodes = numbers(value)
    if len(nodes) == 1:
        nodes = nodes * len(names)
    if len(nodes) != len(names):
        raise scope.fail(f"the value of {d.name!r}, which does not have its size")
    variables = []
    symbols: list[Node] = []
    for variable, node in zip(_scalars(scope, d, nodes), nodes, strict=True):
        free = d.type == "Real" and "constant" not in d.prefixes and node.op == "const"
        symbols.append(scope.builder.symbol(variable.name) if free else node)
        variables.append(variable)
    scope.values[d.name] = _reshape(symbols, value, bool(d.sizes))
    return variables


def _reshape(nodes: list[Node], like: Value, array: bool) -> Value:
    if not array:
        return nodes[0]
    remaining = iter(nodes)

    def build(value: Value) -> Value:
        return [build(v) for v in value] if isinstance(value, list) else next(remaining)

    return build(like) if isinstance(like, list) else list(nodes)


def _scalars(scope: Scope, d: Declaration, bindings: Sequence[Node] | None) -> list[Variable]:
    names = _names(d.name, [scope.integer(s) for s in d.sizes])
    attributes: dict[str, list[Node]] = {}
    unit = ""
    for key, tree in d.attributes.items():
        if isinstance(tree, Text):
            unit = tree.value if key == "unit" else unit
        elif key in ("start", "stateSelect") and (bindings is not None or key == "stateSelect"):
            continue
        else:
            nodes = numbers(scope.value(tree))
            attributes[key] = nodes if len(nodes) == len(names) else [nodes[0]] * len(names)
    variables = []
    for i, name in enumerate(names):
        own = {k: v[i] for k, v in attributes.items()}
        fixed = own.pop("fixed", scope.builder.zero) is scope.builder.one
        binding = bindings[i] if bindings is not None else None
        variables.append(Variable(name, d.prefixes, d.type, d.description, unit, own, fixed, binding))
    return variables
