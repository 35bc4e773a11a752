"""The variables of an FMU and their value references."""

from __future__ import annotations

from dataclasses import dataclass, replace

from aero_bayes.export.causalisation import ExplicitModel
from aero_bayes.export.equation_system import ScalarVariable
from aero_bayes.export.expression import Node
from aero_bayes.language.tokens import without_indices


@dataclass(frozen=True)
class VariableLayout:
    """Which variable has which value reference: states, derivatives, inputs, parameters, dependent ones, outputs.

    ``names`` of states are those of the outputs that equal them where there are any; ``aliases`` maps further names."""

    states: tuple[ScalarVariable, ...]
    state_paths: tuple[str, ...]
    inputs: tuple[ScalarVariable, ...]
    parameters: tuple[ScalarVariable, ...]
    dependent: tuple[ScalarVariable, ...]
    outputs: tuple[ScalarVariable, ...]
    aliases: dict[str, int]

    @property
    def first_parameter(self) -> int:
        """Value reference of the first independent parameter."""
        return 2 * len(self.states) + len(self.inputs)

    @property
    def first_dependent(self) -> int:
        """Value reference of the first dependent parameter."""
        return self.first_parameter + len(self.parameters)

    @property
    def first_output(self) -> int:
        """Value reference of the first output that is no state."""
        return self.first_dependent + len(self.dependent)


def lay_out(model: ExplicitModel, *, sharing: bool = True) -> VariableLayout:
    """Sort the variables that the FMU shows.

    Outputs that equal a state share its value reference; without ``sharing`` one of them does, and the others are
    outputs of their own."""
    b = model.system.builder
    by_name = {v.name: v for v in model.system.variables}
    top = [v for v in model.system.variables if v.shown]
    symbols = {b.symbol(path): i for i, path in enumerate(model.states)}
    position = {o.name: symbols[e] for o in top if (e := model.solved.get(o.name, b.symbol(o.name))) in symbols}
    aliases: dict[str, int] = {}
    states: list[ScalarVariable] = []
    for i, path in enumerate(model.states):
        inner = by_name[path]
        mine = [o for o in top if position.get(o.name) == i]
        if mine:
            first = next((o for o in mine if o.name == path), mine[0])
            if not sharing:
                for other in mine:
                    if other is not first:
                        del position[other.name]
                mine = [first]
            aliases.update({v.name: i for v in (inner, *mine) if sharing and v.name != first.name})
            inner = replace(
                first,
                description=first.description or inner.description,
                unit=first.unit or inner.unit,
                attributes={**inner.attributes, **{k: v for k, v in first.attributes.items() if k != "start"}},
                fixed=inner.fixed,
            )
        states.append(inner)
    expressions = (*model.rates, *(model.solved.get(o.name, b.zero) for o in top), *model.starts)
    used = frozenset[Node]().union(*(b.symbols(e) for e in (*expressions, *model.loop_and_event_expressions)))
    # of an array whose elements are used in part all are shown: Modelica sets an array as a whole
    used_arrays = {without_indices(s.name) for s in used}
    free, dependent = [], []
    for p in model.system.parameters:
        if p.type != "Real" or p.final or p.variability == "constant" or p.binding is None:
            continue
        if p.binding.op == "const":
            if "." not in p.name or without_indices(p.name) in used_arrays:
                free.append(p)
        elif "." not in p.name:
            dependent.append(p)
    outputs = [o for o in (*top, *(v for v in model.system.discrete_variables if v.shown)) if o.name not in position]
    return VariableLayout(
        tuple(states), model.states, model.system.inputs, tuple(free), tuple(dependent), tuple(outputs), aliases
    )
