"""Laws as FMUs of their own, each compiled once a machine."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from aero_bayes.export.compose import attribute_value
from aero_bayes.export.embedded import export_flat
from aero_bayes.export.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.language.syntax import Call, Expression, Name, Number, map_children
from aero_bayes.laws.compose import LawModels
from aero_bayes.laws.coupled_fmu import AttachedLaw
from aero_bayes.laws.law import Law
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.simulation import Model, Variable

#: Suffix of the input that is the derivative of another input.
RATE_SUFFIX = "_rate"


@dataclass(frozen=True, eq=False)
class LawBlocks:
    """The FMUs of laws: inputs are what a law reads, parameters its sizes and what is fitted."""

    models: LawModels
    folder: Path
    _exported: dict[tuple[str, str], Model] = field(default_factory=dict, repr=False)

    def model(self, law: Law) -> Model:
        """Return the FMU of a law."""
        key = (law.kind, law.id)
        if key not in self._exported:
            self._exported[key] = _exported(_block(law, self.models[key]), self.folder)
        return self._exported[key]

    def attached(self, placed: PlacedLaw) -> AttachedLaw:
        """Return the FMU of a placed law, with the names of its parameters, its sizes, and the sizes of its states."""
        model, sizes = self.model(placed.law), placed.all_nominals
        shown = {}
        for p in placed.parameters():
            limits = placed.limits(p)
            shown[p.name] = Variable(
                placed.names[p.name], placed.unit(p), f"{p.description} at {placed.port.id}", placed.value(p),
                limits.get("min"), limits.get("max"), limits.get("nominal"), 0,
            )  # fmt: skip
        own = {v.name for v in (*model.parameters, *model.inputs)}
        given = {name: x for name, x in (sizes | placed.signal_defaults).items() if name in own}
        flat = self.models[placed.law.kind, placed.law.id]
        nominals = tuple(attribute_value(flat, s.name, "nominal", sizes) for s in model.states)
        return AttachedLaw(placed.instance, model, shown, given, nominals)


def can_be_attached(placed: PlacedLaw) -> bool:
    """Return whether a law can be an FMU of its own: not one that gives a force by the acceleration."""
    law, port = placed.law, placed.port
    return port.replaceable is None and (not law.needs_derivative or port.attachment == "output")


def _exported(flat: FlatModel, folder: Path) -> Model:
    key = hashlib.sha256(repr(flat).encode()).hexdigest()[:16]
    out = folder / f"law-{flat.name}-{key}.fmu"
    if not out.exists():
        folder.mkdir(parents=True, exist_ok=True)
        export_flat(flat, out, quick=True)
    return Model.load(out)


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
    fitted = next((p for p in (*law.parameters, *law.starts) if p.name == v.name), None)
    if fitted is not None:  # by itself, and not by the sizes
        return replace(v, binding=Number(fitted.value("default", {**law.nominals, "h_z": 0.0})), attributes={})
    return replace(v, causality="output" if v.name in outputs and "." not in v.name else "local")
