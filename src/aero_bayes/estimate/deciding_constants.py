"""Find fixed parameters that decide a combination of free parameters which the data hardly determine."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.errors import InputError
from aero_bayes.estimate.identifiability import collinear
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.progressive_horizon import OpenSimulator
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.model import Model

#: A fixed parameter decides a direction if freeing it would reduce the information about the direction to this share.
MAX_REMAINING_INFORMATION = 0.01


def name_deciding_constants(fit: Fit, open_simulator: OpenSimulator) -> Fit:
    """The fit with its flat directions completed by the fixed parameters that decide them."""
    if not fit.identifiability.flat:
        return fit
    held = _fixed_parameters(fit)
    calibration = fit.calibration
    wider = replace(calibration, parameters=calibration.parameters.extended(held.items))
    with open_simulator(wider.problem()) as simulator:
        objective = Objective(wider, simulator)
        at = wider.parameters.to_search(np.concatenate([fit.values, held.start]))
        new = range(len(fit.values), len(at))
        found = objective.evaluate(at, [*fit.free, *new])
        if found is None or found.slopes is None:
            return fit
        slopes = objective.whiten(found.residual, found.slopes, fit.noise).slopes
    own = len(fit.free)
    alone = collinear(slopes[:own] @ slopes[:own].T)[0][0]
    guesses = []
    for k, item in enumerate(held):
        rows = slopes[[*range(own), own + k]]
        sizes, vectors = collinear(rows @ rows.T)
        if sizes[0] < MAX_REMAINING_INFORMATION * alone and abs(vectors[-1, 0]) > MAX_REMAINING_INFORMATION:
            guesses.append(f"{item.name} = {item.start:.4g}")
    flat = tuple(replace(direction, held=tuple(guesses)) for direction in fit.identifiability.flat)
    return replace(fit, identifiability=replace(fit.identifiability, flat=flat))


def _fixed_parameters(fit: Fit) -> ParameterSet:
    """Parameters of the model that were not searched, with a value that can change."""
    model, fixed = fit.calibration.model, fit.calibration.fixed
    searched = {p.target.name for p in fit.calibration.parameters if isinstance(p.target, ParameterTarget)}
    items: list[Parameter] = []
    for v in model.parameters:
        value = fixed.get(v.name, v.start)
        if v.name not in searched and value:
            with suppress(InputError):
                items += _at(model, v.name, value).items
    return ParameterSet(tuple(items))


def _at(model: Model, name: str, value: float) -> ParameterSet:
    return parameters_from_model(model, overrides={name: Override(start=value)})
