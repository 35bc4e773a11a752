"""Find fixed parameters that decide a combination of free parameters which the data hardly determine."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.filter_objective import objective_of
from aero_bayes.estimate.identifiability import Identifiability, collinear
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.progressive_horizon import OpenSimulator
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.model import Model

#: A fixed parameter decides a direction if freeing it would reduce the information about the direction to this share.
MAX_REMAINING_INFORMATION = 0.01


def name_deciding_constants(
    found: Identifiability, calibration: Calibration, optimum: Optimum, open_simulator: OpenSimulator
) -> Identifiability:
    """Add the fixed parameters that decide the flat directions of an identifiability."""
    if not found.flat:
        return found
    fixed = _fixed_parameters(calibration)
    values = calibration.parameters.from_search(optimum.coordinates)
    wider = replace(calibration, parameters=calibration.parameters.extended(fixed.items))
    with open_simulator(wider.problem()) as simulator:
        objective = objective_of(wider, simulator)
        at = wider.parameters.to_search(np.concatenate([values, fixed.start]))
        run = objective.evaluate(at, [*optimum.free, *range(len(values), len(at))])
        if run is None or run.slopes is None:
            return found
        slopes = objective.whiten(run, optimum.noise).slopes
    own = len(optimum.free)
    alone = collinear(slopes[:own] @ slopes[:own].T)[0][0]
    deciding = []
    for k, item in enumerate(fixed):
        rows = slopes[[*range(own), own + k]]
        sizes, vectors = collinear(rows @ rows.T)
        if sizes[0] < MAX_REMAINING_INFORMATION * alone and abs(vectors[-1, 0]) > MAX_REMAINING_INFORMATION:
            deciding.append(f"{item.name} = {item.start:.4g}")
    return replace(found, flat=tuple(replace(direction, fixed_names=tuple(deciding)) for direction in found.flat))


def _fixed_parameters(calibration: Calibration) -> ParameterSet:
    """Return the parameters of the model that were not searched, with a value that can change."""
    model, fixed = calibration.model, calibration.simulated.fixed
    searched = {p.target.name for p in calibration.parameters if isinstance(p.target, ParameterTarget)}
    searched |= {name for recording in calibration.data.recordings for name in recording.known}
    items: list[Parameter] = []
    for v in model.parameters:
        value = fixed.get(v.name, v.start)
        if v.name not in searched and value:
            with suppress(InputError):
                items += _at(model, v.name, value).items
    return ParameterSet(tuple(items))


def _at(model: Model, name: str, value: float) -> ParameterSet:
    return parameters_from_model(model, overrides={name: Override(start=value)})
