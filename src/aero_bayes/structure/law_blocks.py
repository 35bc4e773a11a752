"""Laws as FMUs of their own, each compiled once a machine."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.modelica.causalisation import causalise
from aero_bayes.modelica.compose import attribute_value
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.expression import Node
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.modelica.syntax import Call, Expression, Name, Number, map_children
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import Variable
from aero_bayes.structure.compose import LawModels
from aero_bayes.structure.coupled_fmu import AttachedLaw
from aero_bayes.structure.law import Law
from aero_bayes.structure.open_replaceables import effect_block
from aero_bayes.structure.placed_law import PlacedLaw

#: Suffix of the input that is the derivative of another input.
RATE_SUFFIX = "_rate"


class AlgebraicLoopError(Exception):
    """A law and the model have to be solved together, so that it cannot be attached."""


@dataclass(frozen=True, eq=False)
class LawBlocks:
    """The FMUs of laws: inputs are what a law reads, parameters its sizes and what is fitted."""

    models: LawModels
    folder: Path
    _exported: dict[tuple[str, str], Model] = field(default_factory=dict, repr=False)

    def model(self, placed: PlacedLaw) -> Model:
        """Return the FMU of a law. Raises AlgebraicLoopError where it cannot be solved for what it gives."""
        law, place = placed.law, placed.port.replaceable
        key = (law.kind, law.id)
        if key not in self._exported:
            flat = self.models[key]
            join = None if place is None else place.combination
            flat = _block(law, flat) if join is None else effect_block(flat, join)
            try:
                self._exported[key] = self._export(_simplified(_with_fitted(flat, law)), f"{law.kind}_{law.id}")
            except InputError as error:
                raise AlgebraicLoopError(f"{placed.id}: {error}") from None
        return self._exported[key]

    def attached(self, placed: PlacedLaw, name: str, others: Mapping[str, float]) -> AttachedLaw:
        """Return the FMU of a placed law under a name, with its parameters and sizes; ``others`` are further values."""
        model, sizes = self.model(placed), placed.all_nominals
        shown = {}
        for p in placed.parameters():
            limits = placed.limits(p)
            shown[p.name] = Variable(
                placed.names[p.name], placed.unit(p), f"{p.description} at {placed.port.id}", placed.value(p),
                limits.get("min"), limits.get("max"), limits.get("nominal"), 0,
            )  # fmt: skip
        own = {v.name for v in (*model.parameters, *model.inputs)}
        values = {**others, **sizes, **placed.signal_defaults, **{p.name: placed.value(p) for p in placed.parameters()}}
        given = {name: x for name, x in values.items() if name in own}
        flat = self.models[placed.law.kind, placed.law.id]
        nominals = tuple(attribute_value(flat, s.name, "nominal", sizes) for s in model.states)
        return AttachedLaw(name, model, shown, given, nominals)

    def _export(self, flat: FlatModel, name: str) -> Model:
        key = hashlib.sha256(repr(flat).encode()).hexdigest()[:16]
        out = self.folder / f"law-{name}-{key}.fmu"
        if not out.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            export_flat(replace(flat, name=name), out)
        return Model.load(out)


def can_be_attached(placed: PlacedLaw) -> bool:
    """Return whether a law can be an FMU of its own: not one that gives a force by the acceleration."""
    law, port = placed.law, placed.port
    if port.replaceable is not None:
        return port.replaceable.combination is not None
    return not law.needs_derivative or port.attachment == "output"


def _block(law: Law, flat: FlatModel) -> FlatModel:
    """Return a law as a model with inputs and outputs. The derivative of an input is a further input."""
    rated = law.differentiated & set(law.interface.inputs)
    outputs = {law.interface.output, *(v.name for v in flat.variables if v.causality == "output")}

    def without_rates(tree: Expression) -> Expression:
        match tree:
            case Call("der", (Name(name, ()),)) if name in rated:
                return Name(name + RATE_SUFFIX)
        return map_children(tree, without_rates)

    equations = tuple(_changed(e, without_rates) for e in flat.equations)
    variables = [_as_signal(v, law, outputs) for v in flat.variables]
    variables += [FlatVariable(name + RATE_SUFFIX, causality="input") for name in sorted(rated)]
    return replace(flat, name=f"{law.kind}_{law.id}", variables=tuple(variables), equations=equations)


def _changed(e: FlatEquation, change: Callable[[Expression], Expression]) -> FlatEquation:
    return replace(e, left=change(e.left), right=change(e.right))


def _as_signal(v: FlatVariable, law: Law, outputs: set[str]) -> FlatVariable:
    if v.name in law.interface.inputs:
        return replace(v, causality="input", binding=None)
    return replace(v, causality="output" if v.name in outputs and "." not in v.name else "local")


def _with_fitted(flat: FlatModel, law: Law) -> FlatModel:
    """Return a law with values of its fitted parameters that do not depend on the sizes."""
    nominals = {**law.nominals, "h_z": 0.0}
    values = {p.name: Number(p.value("default", nominals)) for p in (*law.parameters, *law.starts)}
    variables = (replace(v, binding=values[v.name], attributes={}) if v.name in values else v for v in flat.variables)
    return replace(flat, variables=tuple(variables))


def _simplified(flat: FlatModel) -> FlatModel:
    """Return a law without inputs that change nothing and outputs that are zero."""
    solved = causalise(translate(flat))
    b = solved.system.builder
    acts = {v.name: solved.solved.get(v.name, b.symbol(v.name)) for v in flat.variables if v.causality == "output"}
    nodes = (*solved.rates, *solved.starts, *acts.values(), *solved.loop_and_event_expressions)
    used = frozenset[Node]().union(*(b.symbols(node) for node in nodes))

    def kept(v: FlatVariable) -> FlatVariable:
        if v.causality == "input" and b.symbol(v.name) not in used:
            return replace(v, causality="local", variability="constant", binding=Number(0.0))
        return replace(v, causality="local") if v.causality == "output" and acts[v.name] is b.zero else v

    return replace(flat, variables=tuple(map(kept, flat.variables)))
