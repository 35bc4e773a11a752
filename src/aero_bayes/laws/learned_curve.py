"""A learned curve in numbers: what a law gives over its signal, and what each of its heights adds."""

from __future__ import annotations

import numpy as np

from aero_bayes.export.causalise import causalise
from aero_bayes.export.expression import evaluate
from aero_bayes.export.translate import translate
from aero_bayes.laws.compose import Models
from aero_bayes.laws.use import Use
from aero_bayes.physics.kin import Basis

#: Points of a curve.
POINTS = 61


def basis_of(use: Use, models: Models) -> Basis:
    """A law that learns a curve, over the size of its signal to both sides."""
    law, sizes = use.law, use.all_sizes
    model = causalise(translate(models[law.kind, law.id]))
    b, acts = model.system.builder, model.solved[law.shape.acts]
    at = {b.symbol(p.name): p.binding.value for p in model.system.parameters if p.binding and p.binding.op == "const"}
    at |= {b.symbol(name): value for name, value in sizes.items()}
    heights = [b.symbol(p.name) for p in law.parameters]
    size = next(name for name, of in law.shape.sizes.items() if of == law.learned and name.endswith("_n"))
    x = sizes.get(f"{size[:-2]}_0", 0.0) + sizes[size] * np.linspace(-1.0, 1.0, POINTS)

    def given(on: int) -> list[float]:
        height = {symbol: float(k == on) for k, symbol in enumerate(heights)}
        return [evaluate([acts], {**at, **height, b.symbol(law.learned): float(value)})[0] for value in x]

    plain = np.array(given(-1))
    rows = np.array([given(k) for k in range(len(heights))]) - plain
    return Basis(x, use.port.units.get(law.learned, ""), plain, rows, use.port.unit)
