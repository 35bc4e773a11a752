"""Which candidate laws refine others."""

from __future__ import annotations

from collections.abc import Mapping

from aero_bayes.laws.placed_law import PlacedLaw


def refinements(placed: Mapping[str, PlacedLaw]) -> dict[str, str]:
    """Return, for each law that refines another one at the same port, the id of that one."""
    known = {(p.law.id, p.port.id): id_ for id_, p in placed.items()}
    coarse = {id_: known.get((p.law.refines, p.port.id)) for id_, p in placed.items()}
    return {id_: of for id_, of in coarse.items() if of is not None}
