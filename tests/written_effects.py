"""Effects of the AERO written into its models, as tests need them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from aero_bayes.laws.model_sources import reserved_names
from aero_bayes.laws.modelica_family import ModelicaFamily
from aero_bayes.laws.placed_law import place_laws
from aero_bayes.laws.write_model import WrittenModel, write_laws


def write_effects(base: str, effects: Mapping[str, Mapping[str, float]], folder: Path, name: str = "") -> WrittenModel:
    """A base system with effects by id, at values of their parameters; defaults where not given."""
    family = ModelicaFamily(base, (), folder)
    chosen = [c for c in family.candidates if c.id in effects]
    uses = place_laws(chosen, reserved_names(family.flat, ()), {})
    uses = tuple(replace(use, values=effects[use.id]) for use in uses)
    return write_laws((), base, family.flat, uses, folder, name)
