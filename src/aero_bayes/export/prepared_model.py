"""Symbols and expressions of a model, prepared for its C source."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property

from aero_bayes.export.expression import Node, evaluate_nodes
from aero_bayes.export.layout import VariableLayout
from aero_bayes.export.parameter_stage import ParameterStage
from aero_bayes.export.switching_surfaces import SwitchingModel


class PreparedModel:
    """A model as its C source computes it: symbols, and expressions with as little work at a time step as possible.

    Parameters of inner components that nothing shows are replaced by their values, and divisions by parameters are
    multiplications."""

    def __init__(self, switching: SwitchingModel, layout: VariableLayout) -> None:
        self.switching, self.layout, self.model = switching, layout, switching.model
        model, b = self.model, self.model.system.builder
        self.builder = b
        self.states = [b.symbol(p) for p in layout.state_paths]
        self.inputs = [b.symbol(v.name) for v in layout.inputs]
        self.parameters = [b.symbol(v.name) for v in layout.parameters]
        self.unknowns = [u for loop in model.loops for u in loop.unknowns]
        self.steps = sorted(model.discrete.updates, key=lambda s: s.name.startswith("when#"))
        self.stage = ParameterStage(b, frozenset(self.parameters))
        self.defaults = {
            p: evaluate_nodes([v.binding], {})[0]
            for p, v in zip(self.parameters, layout.parameters, strict=True)
            if v.binding
        }
        hidden = {
            b.symbol(v.name): v.binding
            for v in model.system.parameters
            if v.binding is not None and v.binding.op == "const" and b.symbol(v.name) not in self.defaults
        }
        #: Values of all parameters.
        self.constants = {**{s: n.value for s, n in hidden.items()}, **self.defaults}
        self._memo = hidden
        self.rates = self.prepare(model.rates)
        self.outputs = self.prepare(model.solved[v.name] for v in layout.outputs)
        self.dependent = self.prepare(v.binding for v in layout.dependent if v.binding is not None)
        self.starts = self.prepare(model.starts)
        self.loops = [self.prepare(loop.residuals) for loop in model.loops]
        self.rows = [*self.rates, *self.outputs, *self.dependent]

    @cached_property
    def instants(self) -> dict[int, tuple[Node, Node]]:
        """Relations that change at a known time: by their number, that time and its slope."""
        relations = enumerate(self.model.discrete.relations)
        return {i: t for i, r in relations if (t := self.model.time_of_change(r.difference)) is not None}

    def prepare(self, nodes: Iterable[Node]) -> list[Node]:
        """Return expressions as they are computed."""
        return [self.stage.reciprocal(self.builder.substitute(n, self._memo)) for n in nodes]

    def step_starts(self) -> Iterator[Node]:
        """Yield values of the discrete variables before the first event."""
        by_name = {v.name: v for v in self.model.system.discrete_variables}
        given, zero = self.model.discrete.before, self.builder.zero
        for s in self.steps:
            declared = by_name[s.name].attributes.get("start", zero) if s.name in by_name else zero
            yield given.get(s, declared)
