"""Which candidate laws are tried on one model together."""

from __future__ import annotations

from collections.abc import Mapping

from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.laws.redeclare import can_be_combined


def refinements(placed: Mapping[str, PlacedLaw]) -> dict[str, str]:
    """Return, for each law that refines another one at the same port, the id of that one."""
    known = {(p.law.id, p.port.id): id_ for id_, p in placed.items()}
    coarse = {id_: known.get((p.law.refines, p.port.id)) for id_, p in placed.items()}
    return {id_: of for id_, of in coarse.items() if of is not None}


def candidate_groups(placed: Mapping[str, PlacedLaw]) -> tuple[tuple[str, ...], ...]:
    """Return groups of ids. The candidates of one group are built into one model."""
    refined = refinements(placed)
    single = [id_ for id_, p in placed.items() if p.port.replaceable is not None and not can_be_combined(p)]
    curves = [id_ for id_, p in placed.items() if p.law.curve_input and id_ not in single]
    laws = {id_: p for id_, p in placed.items() if not p.law.curve_input and id_ not in single}
    replaceable = tuple(id_ for id_, p in laws.items() if p.port.replaceable is not None)
    static = tuple(id_ for id_, p in laws.items() if p.port.replaceable is None and not p.has_states)
    by_port: dict[str, list[str]] = {}
    for id_, p in laws.items():
        if p.has_states and p.port.replaceable is None:
            by_port.setdefault(p.port.id, []).append(id_)
    groups = [
        replaceable,
        static,
        *map(tuple, by_port.values()),
        *((id_,) for id_ in single),
        *(tuple(c for c in curves if (c in refined) is fine) for fine in (False, True)),
    ]
    return tuple(group for group in groups if group)
