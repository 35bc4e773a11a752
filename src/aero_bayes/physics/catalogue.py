"""Declared effects as columns of a search: parameters with priors, and candidates with starts."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.declared import Declaration, Effect, EffectParameter
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.physics.kin import Candidate, magnitude


def effect_parameter(item: EffectParameter) -> Parameter:
    """A parameter of an effect as a search takes it."""
    default = item.default if item.minimum > 0.0 else 0.0
    return magnitude(item.name, item.unit, item.description, (item.minimum, item.maximum), item.scale, default)


def candidates_of(
    declared: Declaration, ids: Sequence[str], outputs: Sequence[str], highest: float
) -> dict[str, tuple[Candidate, tuple[Parameter, ...]]]:
    """Effects that the recorded outputs can show, with parameters; ``highest`` is the largest input."""
    found = {}
    for id_ in ids:
        effect = declared.effect(id_)
        slot = declared.slots[declared.slot_of(effect)]
        if declared.shown(effect.port, outputs) and slot.seen_by in ("", *outputs):
            own = tuple(effect_parameter(item) for item in effect.parameters)
            found[id_] = (Candidate(effect.id, effect.port, _starts(effect, highest)), own)
    return found


def _starts(effect: Effect, highest: float) -> tuple[tuple[float, ...], ...]:
    rows: list[tuple[float, ...]] = [()]
    for item in effect.parameters:
        values = item.starts if item.signed or len(effect.parameters) > 1 else (*item.starts, 0.2 * min(item.starts))
        if item.inverse_shares:
            values = tuple(1.0 / (share * max(highest, 1e-3)) for share in item.inverse_shares)
        rows = [(*row, value) for row in rows for value in values]
    return tuple(rows)
