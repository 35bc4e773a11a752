"""Effects of the AERO written into its models, as tests need them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from aero_bayes.laws.candidates import PlacedLaw, place_laws
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.write_model import WrittenModel, reserved_names, write_laws


def placed_effects(base: str, ids: Collection[str]) -> tuple[PlacedLaw, ...]:
    """Effects of a base system, at sizes of one."""
    places = LawPlaces(base)
    return place_laws([c for c in places.candidates if c.id in ids], reserved_names(places.flat, ()), {})


def write_effects(base: str, effects: Mapping[str, Mapping[str, float]], folder: Path, name: str = "") -> WrittenModel:
    """A base system with effects by id, at values of their parameters; defaults where not given."""
    own = [replace(part, values=effects[p.id]) for p in placed_effects(base, effects) for part in p.parts]
    return write_laws((), base, LawPlaces(base).flat, own, folder, name)
