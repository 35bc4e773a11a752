"""Small rigs as flat models, and their equations in numbers."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from numpy.random import Generator

from aero_bayes.modelica.causalisation import ExplicitModel, causalise
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.expression import Node, evaluate_nodes
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat

RIGS = Path(__file__).parent / "models"


@cache
def rig(model: str, *sources: str) -> FlatModel:
    """A flat model of the test rigs, or of further files."""
    first = model.partition(".")[0]
    return load_flat(model, [Path(s) for s in sources] or [RIGS / f"{first}.mo"])


def explicit(flat: FlatModel) -> ExplicitModel:
    return causalise(translate(flat))


class Numbers:
    """Rates and outputs of a model at one point of its states, inputs and parameters."""

    def __init__(self, model: ExplicitModel) -> None:
        self.model = model
        self.b = model.system.builder
        self.outputs = [v.name for v in model.system.variables if v.causality == "output" and "." not in v.name]
        self.at: dict[Node, float] = {model.system.time: 0.0}
        for p in model.system.parameters:
            if p.binding is not None and p.binding.op == "const":
                self.at[self.b.symbol(p.name)] = p.binding.value

    def names(self) -> list[str]:
        return [*self.model.states, *(v.name for v in self.model.system.inputs)]

    def __call__(self, point: Mapping[str, float]) -> dict[str, float]:
        at = {**self.at, **{self.b.symbol(n): v for n, v in point.items()}}
        named = {f"der({s})": r for s, r in zip(self.model.states, self.model.rates, strict=True)}
        named |= {n: self.model.solved.get(n, self.b.symbol(n)) for n in self.outputs}
        return dict(zip(named, evaluate_nodes(named.values(), at), strict=True))


def somewhere(names: list[str], rng: Generator) -> dict[str, float]:
    return {n: float(v) for n, v in zip(names, rng.uniform(0.2, 1.5, len(names)), strict=True)}
