"""Parameters of placed laws with their priors, and their starting values."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection
from dataclasses import replace

from aero_bayes.declared import DeclaredEffect
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.laws.law import START_PREFIX
from aero_bayes.laws.model_family import effect_parameter
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.simulation.interface import DelayTarget

#: Magnitudes to start from, in nominal values: of a law with further parameters, and of a law with the magnitude only.
#: The latter may act only beyond a threshold, which a coarse grid would step over.
START_MAGNITUDES, START_MAGNITUDES_WITHOUT_SHAPE = (
    (1.0, 0.2, 5.0),
    (1.0, 0.1, 0.3, 0.6, 0.75, 0.8, 0.84, 0.9, 1.2, 1.6, 2.5, 5.0),
)
#: Values of further parameters in nominal values, where their bounds are less than a factor apart.
START_LEVELS, NARROW_BOUND_RATIO = (1.0, 0.85, 0.65, 0.4, 1.1), 30.0


def fitted_parameters(placed: PlacedLaw) -> list[Parameter]:
    """Return the parameters of a placed law with their priors, the magnitude first."""
    found = []
    for p in placed.parameters():
        limits = placed.limits(p)
        bounds = limits.get("min", -1e3 * limits["nominal"]), limits.get("max", 1e3 * limits["nominal"])
        default = p.value("default", placed.all_nominals)
        about = p.description if placed.port.replaceable is not None else f"{p.description} at {placed.port.id}"
        one = effect_parameter(placed.names[p.name], placed.unit(p), about, bounds, limits["nominal"], default)
        if placed.moved_input:
            one = replace(one, target=DelayTarget(placed.moved_input))
        elif p in placed.law.starts:
            one = replace(one, starts=(f"{placed.instance}.{p.name.removeprefix(START_PREFIX)}",))
        found.append(one)
    return found


def starting_values(
    placed: PlacedLaw, effect: DeclaredEffect | None = None, highest: float = 1.0
) -> tuple[tuple[float, ...], ...]:
    """Return starting values of the parameters of a law: all combinations of a few values of each.

    Magnitudes have both signs where the bounds allow it."""
    if placed.law.curve_input:
        return ()
    if effect is not None and (effect.starts or effect.inverse_shares):
        return _declared(placed, effect, highest)
    choices: list[Collection[float]] = []
    parameters = [p for p in placed.parameters() if p not in placed.law.starts]
    for k, p in enumerate(parameters):
        limits = placed.limits(p)
        low, high = limits.get("min", -math.inf), limits.get("max", math.inf)
        scale = limits["nominal"]
        if k == 0:
            static = len(parameters) == 1 and low >= 0.0 and not placed.has_states
            sizes = [
                m * scale
                for m in (START_MAGNITUDES_WITHOUT_SHAPE if static or placed.law.threshold else START_MAGNITUDES)
            ]
            values = [s for s in sizes if s <= high] + ([-s for s in sizes if -s >= low] if low < 0.0 else [])
        elif low > 0.0 and high < NARROW_BOUND_RATIO * low:
            values = [m * scale for m in START_LEVELS if low < m * scale < high]
        elif low > 0.0:
            values = [scale, math.sqrt(scale * low), math.sqrt(scale * high)]
        else:
            values = [scale] if low >= 0.0 else [scale, -scale]
        choices.append(values)
    return tuple(itertools.product(*choices))


def _declared(placed: PlacedLaw, effect: DeclaredEffect, highest: float) -> tuple[tuple[float, ...], ...]:
    choices: list[tuple[float, ...]] = []
    parameters = [p for p in placed.parameters() if p not in placed.law.starts]
    for p in parameters:
        limits = placed.limits(p)
        values = effect.starts.get(p.name, (limits["nominal"],))
        if len(parameters) == 1 and limits.get("min", -math.inf) >= 0.0:
            values = (*values, 0.2 * min(values))
        if p.name in effect.inverse_shares:
            values = tuple(1.0 / (share * max(highest, 1e-3)) for share in effect.inverse_shares[p.name])
        choices.append(values)
    return tuple(itertools.product(*choices))
