"""The catalogue's effects as columns of a search: parameters with priors, and candidates with starts."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.estimate.parameters import Parameter
from aero_bayes.export import CATALOGUE, Effect, EffectParameter
from aero_bayes.physics.kin import Candidate, magnitude


def effect_parameter(item: EffectParameter) -> Parameter:
    """A parameter of an effect as a search takes it."""
    default = item.default if item.minimum > 0.0 else 0.0
    return magnitude(item.name, item.unit, item.description, (item.minimum, item.maximum), item.scale, default)


def candidates_of(
    ids: Sequence[str], outputs: Sequence[str], highest: float
) -> dict[str, tuple[Candidate, tuple[Parameter, ...]]]:
    """Effects that the recorded outputs can show, with parameters; ``highest`` is the greatest voltage asked for."""
    found = {}
    for id_ in ids:
        effect = CATALOGUE[id_]
        if _visible(effect, outputs):
            own = tuple(effect_parameter(item) for item in effect.parameters)
            found[id_] = (Candidate(effect.id, effect.port, _starts(effect, highest)), own)
    return found


def _visible(effect: Effect, outputs: Sequence[str]) -> bool:
    shown = {"CurrentSensor": "i_m", "SpeedSensor": "omega_m", "PitchSensor": "theta"}
    if effect.slot in shown:
        return shown[effect.slot] in outputs
    return effect.port not in ("thrust", "body") or "theta" in outputs


def _starts(effect: Effect, highest: float) -> tuple[tuple[float, ...], ...]:
    if effect.id == "amplifier_saturation":
        # A limit acts only below the greatest voltage that was asked for.
        return tuple((1.0 / (share * max(highest, 1e-3)),) for share in (0.96, 0.85, 0.7, 0.55))
    rows: list[tuple[float, ...]] = [()]
    for item in effect.parameters:
        values = item.starts if item.signed or len(effect.parameters) > 1 else (*item.starts, 0.2 * min(item.starts))
        rows = [(*row, value) for row in rows for value in values]
    return tuple(rows)
