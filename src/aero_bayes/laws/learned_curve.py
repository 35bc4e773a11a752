"""Learned curves: their basis functions in numbers, and the inputs over which they are learned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.export.causalisation import causalise
from aero_bayes.export.compose import add_output
from aero_bayes.export.equation_system import translate
from aero_bayes.export.expression import evaluate_nodes
from aero_bayes.export.flat import FlatModel
from aero_bayes.language.syntax import Call, Expression, Name, Number, map_names
from aero_bayes.laws.compose import LawModels
from aero_bayes.laws.model_family import CurveBasis
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.laws.redeclare import component_path
from aero_bayes.ports import NEGLIGIBLE_TERM

#: Points at which a curve is evaluated.
CURVE_POINTS = 61


def curve_basis(placed: PlacedLaw, models: LawModels) -> CurveBasis:
    """Return the basis functions of a learned curve, over its nominal input range to both sides."""
    law, nominals = placed.law, placed.all_nominals
    model = causalise(translate(models[law.kind, law.id]))
    b, acts = model.system.builder, model.solved[law.interface.output]
    at = {b.symbol(p.name): p.binding.value for p in model.system.parameters if p.binding and p.binding.op == "const"}
    at |= {b.symbol(name): value for name, value in nominals.items()}
    heights = [b.symbol(p.name) for p in law.parameters]
    size = next(name for name, of in law.interface.nominals.items() if of == law.curve_input and name.endswith("_n"))
    x = nominals.get(f"{size[:-2]}_0", 0.0) + nominals[size] * np.linspace(-1.0, 1.0, CURVE_POINTS)

    def curve(on: int) -> list[float]:
        height = {symbol: float(k == on) for k, symbol in enumerate(heights)}
        return [evaluate_nodes([acts], {**at, **height, b.symbol(law.curve_input): float(value)})[0] for value in x]

    plain = np.array(curve(-1))
    rows = np.array([curve(k) for k in range(len(heights))]) - plain
    return CurveBasis(x, placed.port.units.get(law.curve_input, ""), plain, rows, placed.port.unit)


def curve_variable(placed: PlacedLaw) -> str:
    """Return the variable over which a curve is learned, for a reader."""
    if placed.port.replaceable is None:
        return placed.port.signals.get(placed.law.curve_input, placed.port.id)
    about = next((c.description for c in placed.law.cls.components() if c.name == placed.law.curve_input), "")
    return f"{about[:1].lower()}{about[1:]}" or placed.port.id


def isolated_curve(flat: FlatModel, placed: PlacedLaw) -> tuple[PlacedLaw, LawModels]:
    """Take a curve out of a replaceable model, from a flat model in which it is the only law there."""
    prefix = f"{component_path(placed, [placed])}."
    kept = {
        placed.law.curve_input,
        placed.law.interface.output,
        *placed.all_nominals,
        *(p.name for p in placed.law.parameters),
    }

    def inner(n: Name) -> Expression:
        return Name(n.name.removeprefix(prefix), n.subscripts)

    variables = tuple(
        replace(
            v,
            name=name,
            causality="input" if name == placed.law.curve_input else "local",
            binding=Number(0.0) if v.constant else None,
        )
        for v in flat.variables
        if v.name.startswith(prefix) and (name := v.name.removeprefix(prefix)) in kept
    )
    equations = tuple(
        replace(e, left=map_names(e.left, inner), right=map_names(e.right, inner), component="")
        for e in flat.equations
        if isinstance(e.left, Name) and e.left.name == f"{prefix}{placed.law.interface.output}"
    )
    part = FlatModel(placed.law.id, variables, equations, functions=flat.functions)
    units = {v.name: v.unit for v in variables}
    port = replace(
        placed.port,
        unit=units[placed.law.interface.output],
        units={placed.law.curve_input: units[placed.law.curve_input]},
    )
    return replace(placed, port=port), {(placed.law.kind, placed.law.id): part}


def with_curve_inputs(flat: FlatModel, placed_laws: Sequence[PlacedLaw]) -> tuple[FlatModel, dict[str, str]]:
    """Return a model with further outputs, the inputs of curves in its replaceable models, and their names by id."""
    names = {placed.id: f"learned_over_{k}" for k, placed in enumerate(placed_laws)}
    for placed in placed_laws:
        signal = Name(f"{component_path(placed, placed_laws)}.{placed.law.curve_input}")
        flat = add_output(flat, names[placed.id], Call("+", (signal, NEGLIGIBLE_TERM)))
    return flat, names
