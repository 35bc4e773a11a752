"""Effects of the AERO written into its models, as tests need them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from aero_bayes.structure.candidates import place_laws
from aero_bayes.structure.law_places import LawPlaces
from aero_bayes.structure.write_model import WrittenModel, reserved_names, write_laws


def write_effects(base: str, effects: Mapping[str, Mapping[str, float]], folder: Path, name: str = "") -> WrittenModel:
    """A base system with effects by id, at values of their parameters; defaults where not given."""
    places = LawPlaces(base)
    chosen = [c for c in places.candidates if c.id in effects]
    uses = place_laws(chosen, reserved_names(places.flat, ()), {})
    uses = tuple(replace(use, values=effects[use.id]) for use in uses)
    return write_laws((), base, places.flat, uses, folder, name)
