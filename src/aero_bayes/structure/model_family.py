"""Candidates of a loop: their parameters with priors and starting values, and what models with them consist of."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from aero_bayes.arrays import FloatArray
from aero_bayes.declared import DeclaredEffect
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import LogUniform, Normal
from aero_bayes.simulation.interface import (
    DelayTarget,
    DiffusionTarget,
    ParameterTarget,
    Problem,
    Simulator,
    StartTarget,
)
from aero_bayes.simulation.model import Model
from aero_bayes.structure.candidates import PlacedLaw
from aero_bayes.structure.law import START_PREFIX
from aero_bayes.structure.write_model import WrittenModel

OpenSimulator = Callable[[Problem], Simulator]

#: Prior standard deviation of the magnitude of an effect, in nominal values.
MAGNITUDE_PRIOR_FACTOR = 3.0


#: Starting points of the parameters of a candidate.
Starts = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class CandidateTerm:
    """A term that the model may lack."""

    id: str
    port: str
    starts: Starts
    columns: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class ModelWithCandidates:
    """A model with candidate terms built in, all switched off, and the parameters of each."""

    model: Model
    terms: Sequence[tuple[CandidateTerm, Sequence[Parameter]]]


@dataclass(frozen=True, eq=False)
class ExtendedModel(WrittenModel):
    """A model with effects, written as Modelica and exported."""

    model: Model
    parameters: tuple[Parameter, ...]
    names: Mapping[str, tuple[tuple[str, str], ...]]
    widths: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class CurveBasis:
    """Basis functions of a learned curve, which is linear in its heights."""

    x: FloatArray
    x_unit: str
    plain: FloatArray
    rows: FloatArray
    unit: str


def calibration_on(calibration: Calibration, model: Model, names: Mapping[str, str]) -> Calibration:
    """Return a calibration with another model. ``names`` gives the names there of states that are named otherwise."""

    def renamed(by_state: Mapping[str, float]) -> dict[str, float]:
        return {names.get(state, state): value for state, value in by_state.items()}

    data = calibration.data.with_experiments(
        replace(e, start=renamed(e.start), start_sd=renamed(e.start_sd)) for e in calibration.data.experiments
    )
    parameters = tuple(
        replace(p, target=replace(p.target, state=names.get(p.target.state, p.target.state)))
        if isinstance(p.target, StartTarget | DiffusionTarget)
        else p
        for p in calibration.parameters
    )
    process = calibration.process
    if process is not None:
        process = replace(process, diffusion=renamed(process.diffusion))
    return replace(calibration, data=data, model=model, process=process, parameters=ParameterSet(parameters))


#: Magnitudes to start from, in nominal values: of a law with further parameters, and of a law with the magnitude only.
#: The latter may act only beyond a threshold, which a coarse grid would step over.
START_MAGNITUDES, START_MAGNITUDES_WITHOUT_SHAPE = (
    (1.0, 0.2, 5.0),
    (1.0, 0.1, 0.3, 0.6, 0.75, 0.8, 0.84, 0.9, 1.2, 1.6, 2.5, 5.0),
)
#: Values of further parameters in nominal values, where their bounds are less than a factor apart.
START_LEVELS, NARROW_BOUND_RATIO = (1.0, 0.85, 0.65, 0.4, 1.1), 30.0


def fitted_parameters(placed: PlacedLaw) -> list[Parameter]:
    """Return the parameters of a placed law with their priors, the magnitude first.

    A prior is normal about zero, or log-uniform where the bounds are positive."""
    found = []
    for p in placed.parameters():
        limits = placed.limits(p)
        low, high = limits.get("min", -1e3 * limits["nominal"]), limits.get("max", 1e3 * limits["nominal"])
        name, default = placed.names[p.name], p.value("default", placed.all_nominals)
        positive = low > 0.0
        prior = LogUniform(low, high) if positive else Normal(0.0, MAGNITUDE_PRIOR_FACTOR * limits["nominal"])
        target = DelayTarget(placed.moved_input) if placed.moved_input else ParameterTarget(name)
        one = Parameter(
            name, placed.unit(p), default, low, high, prior, "log" if positive else "linear", placed.about(p), target
        )
        if p in placed.law.starts and not placed.moved_input:
            one = replace(one, starts=(f"{placed.instance}.{p.name.removeprefix(START_PREFIX)}",))
        found.append(one)
    return found


def starting_values(placed: PlacedLaw, effect: DeclaredEffect | None = None, highest: float = 1.0) -> Starts:
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


def _declared(placed: PlacedLaw, effect: DeclaredEffect, highest: float) -> Starts:
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
