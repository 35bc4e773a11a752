"""A learned curve in numbers: what a law gives over its signal, and what each of its heights adds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.export.causalise import causalise
from aero_bayes.export.compose import add_output
from aero_bayes.export.equation_system import translate
from aero_bayes.export.expression import evaluate_nodes
from aero_bayes.export.flat import FlatModel
from aero_bayes.language.syntax import Call, Expression, Name, Number, map_names
from aero_bayes.laws.compose import Models
from aero_bayes.laws.family import Basis
from aero_bayes.laws.redeclare import component_of
from aero_bayes.laws.use import Use
from aero_bayes.ports.sizes import NEGLIGIBLE

#: Points of a curve.
CURVE_POINTS = 61


def basis_of(use: Use, models: Models) -> Basis:
    """A law that learns a curve, over the size of its signal to both sides."""
    law, sizes = use.law, use.all_sizes
    model = causalise(translate(models[law.kind, law.id]))
    b, acts = model.system.builder, model.solved[law.shape.acts]
    at = {b.symbol(p.name): p.binding.value for p in model.system.parameters if p.binding and p.binding.op == "const"}
    at |= {b.symbol(name): value for name, value in sizes.items()}
    heights = [b.symbol(p.name) for p in law.parameters]
    size = next(name for name, of in law.shape.sizes.items() if of == law.learned and name.endswith("_n"))
    x = sizes.get(f"{size[:-2]}_0", 0.0) + sizes[size] * np.linspace(-1.0, 1.0, CURVE_POINTS)

    def given(on: int) -> list[float]:
        height = {symbol: float(k == on) for k, symbol in enumerate(heights)}
        return [evaluate_nodes([acts], {**at, **height, b.symbol(law.learned): float(value)})[0] for value in x]

    plain = np.array(given(-1))
    rows = np.array([given(k) for k in range(len(heights))]) - plain
    return Basis(x, use.port.units.get(law.learned, ""), plain, rows, use.port.unit)


def over(use: Use) -> str:
    """What a curve is learned over."""
    if use.port.replaceable is None:
        return use.port.signals.get(use.law.learned, use.port.id)
    about = next((c.description for c in use.law.cls.components() if c.name == use.law.learned), "")
    return f"{about[:1].lower()}{about[1:]}" or use.port.id


def curve_alone(flat: FlatModel, use: Use) -> tuple[Use, Models]:
    """A curve in a replaceable model as a model of its own, from a model that has it and no other law there."""
    prefix = f"{component_of(use, [use])}."
    kept = {use.law.learned, use.law.shape.acts, *use.all_sizes, *(p.name for p in use.law.parameters)}

    def inner(n: Name) -> Expression:
        return Name(n.name.removeprefix(prefix), n.subscripts)

    variables = tuple(
        replace(
            v,
            name=name,
            causality="input" if name == use.law.learned else "local",
            binding=Number(0.0) if v.constant else None,
        )
        for v in flat.variables
        if v.name.startswith(prefix) and (name := v.name.removeprefix(prefix)) in kept
    )
    equations = tuple(
        replace(e, left=map_names(e.left, inner), right=map_names(e.right, inner), component="")
        for e in flat.equations
        if isinstance(e.left, Name) and e.left.name == f"{prefix}{use.law.shape.acts}"
    )
    part = FlatModel(use.law.id, variables, equations, functions=flat.functions)
    units = {v.name: v.unit for v in variables}
    port = replace(use.port, unit=units[use.law.shape.acts], units={use.law.learned: units[use.law.learned]})
    return replace(use, port=port), {(use.law.kind, use.law.id): part}


def watched_curves(flat: FlatModel, uses: Sequence[Use]) -> tuple[FlatModel, dict[str, str]]:
    """A model whose further outputs are what curves in its replaceable models are over, and their names by id."""
    names = {use.id: f"learned_over_{k}" for k, use in enumerate(uses)}
    for use in uses:
        signal = Name(f"{component_of(use, uses)}.{use.law.learned}")
        flat = add_output(flat, names[use.id], Call("+", (signal, NEGLIGIBLE)))
    return flat, names
