"""The row of a rig in the fleet's table: the numbers of its ``result.json`` that the fleet needs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from aero_bayes.estimate.parameters import Parameter
from aero_bayes.fleets.table import Row
from aero_bayes.schema import EffectJson, LoopJson, ParameterJson, RunJson
from aero_bayes.simulation.gaussian import NORMAL_HALF_WIDTH

#: A rig whose likelihood has less than this share of its posterior's precision tells only its prior.
MIN_LIKELIHOOD_SHARE = 0.05


def fleet_row(name: str, result: RunJson, priors: Iterable[Parameter]) -> Row:
    """Make the row of a finished rig."""
    searched, loop, words = {item.name: item for item in priors}, result.loop, result.effect_words()
    effects = loop.effects if loop else []
    wanted = {*searched, *(key for effect in effects for key in effect.parameters)}
    ratios = [one.ratio for outputs in result.residual.values() for one in outputs.values() if one.ratio is not None]
    return {
        "key": name,
        "simulated": result.simulated,
        "level": result.verdict.level if result.verdict else "",
        "parameters": {
            key: _parameter(entry, searched.get(key))
            for key, entry in result.parameters.items()
            if key in wanted and entry.status != "fixed" and entry.value is not None
        },
        "over_floor": max(ratios, default=None),
        "outcome": loop.outcome if loop else "",
        "effects": [_named(effect, loop) for effect in effects] if loop else [],
        "words": {effect.id: words.get(effect.id, "") for effect in effects},
    }


def _parameter(entry: ParameterJson, item: Parameter | None) -> dict[str, Any]:
    stated = {"value": entry.value, "sd": entry.sd, "unit": entry.unit, "status": entry.status}
    low, middle, high = entry.q05, entry.q50, entry.q95
    if low is None or middle is None or high is None or not high > low:
        return stated
    floor = item.lower if item is not None else entry.lower
    log = low > 0.0 and floor is not None and floor >= 0.0
    if log:
        low, middle, high = math.log(low), math.log(middle), math.log(high)
    likelihood = _without_prior(middle, (high - low) / (2.0 * NORMAL_HALF_WIDTH), item, log=log)
    return stated | {"log": log, "centre": likelihood[0], "width": likelihood[1]} if likelihood else stated


def _without_prior(centre: float, sd: float, item: Parameter | None, *, log: bool) -> tuple[float, float] | None:
    """Compute centre and width of the likelihood: a Gaussian posterior over the prior's own curvature.

    The fleet takes the place of the rig's prior; with both it would be counted once a rig. None if little is left."""
    if item is None:
        return centre, sd
    value = min(max(math.exp(centre) if log else centre, item.lower), item.upper)
    first, second = item.prior.derivatives(np.array([value]))
    slope, bend = float(first[0]), float(second[0])
    if log:
        slope, bend = slope * value + 1.0, bend * value**2 + slope * value
    precision = 1.0 / sd**2 + bend
    return (centre - slope / precision, precision**-0.5) if precision >= MIN_LIKELIHOOD_SHARE / sd**2 else None


def _named(effect: EffectJson, loop: LoopJson) -> dict[str, Any]:
    """Describe an effect that the loop named, and those that its data cannot tell from it."""
    alike = next((group for group in loop.equivalent if effect.id in group), [])
    return {"id": effect.id, "alike": [id_ for id_ in alike if id_ != effect.id]}
