"""Flat model -> parameters, variables, residuals and events over the expression graph."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from aero_bayes.modelica import array_values
from aero_bayes.modelica.array_values import scalars
from aero_bayes.modelica.discrete import DiscretePart, EventActions, assigned_in_events, match_discrete
from aero_bayes.modelica.expression import Builder, Node, evaluate_nodes
from aero_bayes.modelica.flat import Causality, FlatEquation, FlatModel, FlatVariable, Variability
from aero_bayes.modelica.graphs import reachable
from aero_bayes.modelica.operators import Events, is_table_type
from aero_bayes.modelica.scope import Scope
from aero_bayes.modelica.syntax import Call, Name, Number, names_in


@dataclass(frozen=True)
class ScalarVariable:
    """A scalar of the model: its name, its attributes as expressions, and where it is declared to act."""

    name: str
    type: str
    variability: Variability
    causality: Causality
    description: str
    unit: str
    attributes: Mapping[str, Node]
    fixed: bool
    binding: Node | None
    state_select: str = "default"
    final: bool = False

    def attribute(self, key: str, values: Mapping[Node, float], otherwise: float) -> float:
        """Return the number of an attribute at given values of what it depends on."""
        return evaluate_nodes([self.attributes[key]], values)[0] if key in self.attributes else otherwise

    @property
    def shown(self) -> bool:
        """An output of the model itself."""
        return self.causality == "output" and "." not in self.name


@dataclass(frozen=True)
class EquationSystem:
    """Residuals ``0 = r`` over symbols. ``der(x)`` is the symbol of that name; dependent parameters are resolved.

    ``discrete`` is what happens in events. Between them its symbols are constant."""

    name: str
    builder: Builder
    time: Node
    parameters: tuple[ScalarVariable, ...]
    inputs: tuple[ScalarVariable, ...]
    variables: tuple[ScalarVariable, ...]
    residuals: tuple[Node, ...]
    initial_residuals: tuple[Node, ...]
    discrete_variables: tuple[ScalarVariable, ...]
    discrete: DiscretePart
    derivatives: dict[str, Node] = field(default_factory=dict)


def translate(model: FlatModel) -> EquationSystem:
    """Turn a flat model into residuals over symbols."""
    model = _solved_at_start(model)
    builder = Builder()
    time = builder.symbol("time")
    events = Events(builder)
    scope = Scope(builder, model.functions, {"time": time}, f"model {model.name}", records=model.records)
    others = [v for v in model.variables if not v.constant]
    _declare(scope, events, others)
    parameters = _parameters(scope, [v for v in model.variables if v.constant])
    events.piecewise_constant |= {builder.symbol(p.name) for p in parameters}
    inputs, discrete_variables, variables = _sorted_variables(scope, others, assigned_in_events(model))
    symbols = [builder.symbol(v.name) for v in discrete_variables]
    events.piecewise_constant |= set(symbols)
    scope.place, scope.operators.events = None, events
    actions = EventActions(scope, events)
    residuals = _residuals(model, scope, actions, symbols)
    before, initial = _initial(model, scope, actions, symbols)
    memo = {limit: x for limit, x in scope.operators.left_limits.items() if x.name in scope.operators.derivatives}
    residuals = [builder.substitute(r, memo) for r in residuals]
    initial = tuple(builder.substitute(r, memo) for r in initial)
    outside = frozenset[Node]().union(*(builder.symbols(r) for r in (*residuals, *initial, *before.values())))
    driven = {builder.symbol(v.name) for v in inputs}
    for limit, x in scope.operators.left_limits.items():
        if x in driven or limit in outside:
            raise scope.fail(f"pre({x.name}) of a variable that is neither discrete nor a state")
    discrete = DiscretePart(
        actions.updates,
        tuple(actions.reinits),
        tuple(events.relations.values()),
        tuple(events.roundings.values()),
        tuple(events.samplings.values()),
        _assertions(model, scope),
        before,
        scope.operators.left_limits,
    )
    return EquationSystem(
        model.name,
        builder,
        time,
        tuple(parameters),
        tuple(inputs),
        tuple(variables),
        tuple(residuals),
        initial,
        tuple(discrete_variables),
        discrete,
        scope.operators.derivatives,
    )


def _declare(scope: Scope, events: Events, variables: Sequence[FlatVariable]) -> None:
    """Give the names of variables their symbols."""
    builder = scope.builder
    for v in variables:
        scope.place = v.place
        if v.type == "String":
            raise scope.fail(f"the variable {v.name!r} of type String")
        symbols_of = array_values.shaped(map(builder.symbol, v.scalar_names), v.sizes)
        switched = v.type == "Boolean" and _is_input(v)
        # An FMU of ours has Real inputs: a switch is on above one half.
        scope.values[v.name] = (
            array_values.mapped(lambda s: events.relation("gt", s, builder.const(0.5)), symbols_of)
            if switched
            else symbols_of
        )


def _sorted_variables(
    scope: Scope, declared: Sequence[FlatVariable], in_events: Collection[str]
) -> tuple[list[ScalarVariable], list[ScalarVariable], list[ScalarVariable]]:
    """Inputs, discrete variables (those that are assigned ``in_events``, too), and the rest."""
    inputs: list[ScalarVariable] = []
    discrete: list[ScalarVariable] = []
    variables: list[ScalarVariable] = []
    for v in declared:
        scope.place = v.place
        for variable in _scalars(scope, v, None):
            if _is_input(v):
                if v.type not in ("Real", "Integer", "Boolean"):
                    raise scope.fail(f"the input {v.name!r} of type {v.type}")
                inputs.append(replace(variable, type="Real", variability="continuous"))
            elif v.variability == "discrete" or v.name in in_events:
                discrete.append(variable)
            else:
                variables.append(variable)
    return inputs, discrete, variables


def _residuals(model: FlatModel, scope: Scope, actions: EventActions, discrete: Sequence[Node]) -> list[Node]:
    """Run what happens in events, and return the residuals of equations and algorithms."""
    b = scope.builder
    for clause in model.whens:
        actions.clause(clause)
    residuals: list[Node] = []
    for algorithm in model.algorithms:
        scope.place = algorithm.place
        residuals += [b.sub(new, s) for s, new in actions.algorithm(algorithm.statements, algorithm.outputs)]
    open_ = set(discrete) - actions.updates.keys()
    pairs: list[tuple[Node, Node]] = []
    for left, right in scope.sides(model.equations):
        if left in open_ or right in open_:
            pairs.append((left, right))
        else:
            residuals.append(b.sub(right, left))
    return residuals + [b.sub(right, left) for left, right in match_discrete(scope, pairs, actions, discrete)]


def _solved_at_start(model: FlatModel) -> FlatModel:
    """Make states that stay as they start of parameters that initial equations determine (``fixed = false``).

    Parameters that follow from them become variables."""
    open_ = {
        v.name for v in model.variables if v.variability == "parameter" and v.attributes.get("fixed") == Number(0.0)
    }
    if not open_:
        return model
    parameters = ((v.name, v.binding) for v in model.variables if v.variability == "parameter")
    bound = {name: names_in(binding) for name, binding in parameters if binding is not None}
    follow = reachable(open_, lambda name: (other for other, names in bound.items() if name in names))
    variables, equations = [], []
    for v in model.variables:
        if v.name not in follow:
            variables.append(v)
            continue
        if v.name in open_:
            equations.append(FlatEquation(Call("der", (Name(v.name),)), Number(0.0), "added", place=v.place))
        elif v.binding is not None:
            equations.append(FlatEquation(Name(v.name), v.binding, "binding", place=v.place))
        attributes = {k: t for k, t in v.attributes.items() if k != "fixed"}
        variables.append(replace(v, variability="continuous", binding=None, attributes=attributes))
    return replace(model, variables=tuple(variables), equations=(*model.equations, *equations))


def _initial(
    model: FlatModel, scope: Scope, actions: EventActions, discrete: Sequence[Node]
) -> tuple[dict[Node, Node], tuple[Node, ...]]:
    """Return what initial equations and algorithms say.

    Values of discrete variables before the start, and residuals."""
    of = {s: s for s in discrete} | {scope.builder.symbol(f"pre({s.name})"): s for s in discrete}
    pairs: list[tuple[Node, Node]] = []
    with scope.events_in(None):
        for algorithm in model.initial_algorithms:
            scope.place = algorithm.place
            pairs += actions.run(algorithm.statements, algorithm.outputs)
    pairs += scope.sides(model.initial_equations)
    before: dict[Node, Node] = {}
    residuals = []
    for left, right in pairs:
        if left in of or right in of:
            known, value = (left, right) if left in of else (right, left)
            before[of[known]] = value
        else:
            residuals.append(scope.builder.sub(right, left))
    scope.place = None
    return before, tuple(residuals)


def _assertions(model: FlatModel, scope: Scope) -> tuple[tuple[Node, str], ...]:
    """Assertions that may fail; they are looked at in events and make none themselves."""
    found = []
    with scope.events_in(None):
        for a in model.assertions:
            scope.place = a.place
            found += [(c, a.message) for c in scalars(scope.value(a.condition)) if c.op != "const" or not c.value]
    scope.place = None
    return tuple(found)


def _parameters(scope: Scope, declared: Sequence[FlatVariable]) -> list[ScalarVariable]:
    """Declare parameters and constants in order of dependence; a literal binding makes an independent parameter."""
    by_name = {v.name: v for v in declared}
    found: dict[str, list[ScalarVariable]] = {}
    open_: set[str] = set()

    def declare(v: FlatVariable) -> None:
        if v.name in found:
            return
        scope.place = v.place
        if v.name in open_:
            raise scope.fail(f"the parameter {v.name!r}, which depends on itself")
        open_.add(v.name)
        trees = [t for t in (v.binding, *v.attributes.values()) if t is not None]
        for name in {n for t in trees for n in names_in(t)}:
            for needed in _declarations(name, by_name):
                if needed.name != v.name:
                    declare(needed)
        scope.place = v.place
        found[v.name] = _parameter(scope, v)

    for v in declared:
        declare(v)
    scope.place = None
    return [x for v in declared for x in found[v.name]]


def _is_input(v: FlatVariable) -> bool:
    return v.causality == "input" and "." not in v.name


def _declarations(name: str, by_name: Mapping[str, FlatVariable]) -> Iterable[FlatVariable]:
    """Yield the parameters that a reference may mean: itself, or the fields of a record."""
    if name in by_name:
        yield by_name[name]
        return
    for other, v in by_name.items():
        if other.startswith((name + ".", name + "[")) or re.sub(r"\[\d+\]", "", other) == name:
            yield v


def _parameter(scope: Scope, v: FlatVariable) -> list[ScalarVariable]:
    fixed = v.attributes.get("fixed")
    if fixed is not None and any(n is scope.builder.zero for n in scalars(scope.value(fixed))):
        raise scope.fail(f"the parameter {v.name!r} with fixed=false")
    if v.value is None:
        raise scope.fail(f"the parameter {v.name!r} without a value")
    value = scope.value(v.value)
    if isinstance(value, str) or is_table_type(v.type):
        scope.values[v.name] = value
        return []
    names = v.scalar_names
    nodes = scalars(value)
    if len(nodes) == 1:
        nodes = nodes * len(names)
    if len(nodes) != len(names):
        raise scope.fail(f"the value of {v.name!r}, which does not have its size")
    variables = []
    symbols: list[Node] = []
    for variable, node in zip(_scalars(scope, v, nodes), nodes, strict=True):
        free = v.type == "Real" and v.variability != "constant" and node.op == "const"
        symbols.append(scope.builder.symbol(variable.name) if free else node)
        variables.append(variable)
    scope.values[v.name] = array_values.shaped(iter(symbols), v.sizes)
    return variables


def _scalars(scope: Scope, v: FlatVariable, bindings: Sequence[Node] | None) -> list[ScalarVariable]:
    names = v.scalar_names
    attributes: dict[str, list[Node]] = {}
    for key, tree in v.attributes.items():
        if key == "start" and bindings is not None:
            continue
        nodes = scalars(scope.value(tree))
        attributes[key] = nodes if len(nodes) == len(names) else nodes[:1] * len(names)
    variables = []
    for i, name in enumerate(names):
        own = {k: n[i] for k, n in attributes.items() if n}
        fixed = own.pop("fixed", scope.builder.zero) is scope.builder.one
        binding = bindings[i] if bindings is not None else None
        variables.append(
            ScalarVariable(
                name,
                v.type,
                v.variability,
                v.causality,
                v.description,
                v.unit,
                own,
                fixed,
                binding,
                v.state_select,
                v.final,
            )
        )
    return variables
