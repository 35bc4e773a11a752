"""Effects of the AERO written into its models, as tests need them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from aero_bayes.laws.model_sources import names_taken
from aero_bayes.laws.rig_family import RigFamily
from aero_bayes.laws.use import uses_of
from aero_bayes.laws.write import Written, write_laws


def write_effects(base: str, effects: Mapping[str, Mapping[str, float]], folder: Path, name: str = "") -> Written:
    """A base system with effects by id, at values of their parameters; defaults where not given."""
    family = RigFamily(base, (), folder)
    chosen = [c for c in family.every if c.id in effects]
    uses = uses_of(chosen, names_taken(family.flat, ()), {})
    uses = tuple(replace(use, values=effects[use.id]) for use in uses)
    return write_laws((), base, family.flat, uses, folder, name)
