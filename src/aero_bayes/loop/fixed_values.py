"""Fixed parameters that would explain as much as a chosen term if they were free: a wrong value imitates an effect."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.parameters import Parameter, ParameterSet, parameters_from_model
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.search.explored import SearchResult
from aero_bayes.search.models import FittedModel, ModelCache
from aero_bayes.search.process_noise import EQUIVALENT
from aero_bayes.simulation.model import Model

#: Share of a term's gain that freeing a fixed parameter must predict for a refit, and the largest number of refits.
MIN_GAIN_SHARE, MAX_REFITS = 0.05, 3
#: Largest number of fixed parameters that are examined; an FMU may have hundreds.
MAX_PARAMETERS = 40


@dataclass(frozen=True)
class FixedValueAlternative:
    """A fixed parameter whose ``value``, in place of ``fixed``, replaces a term at a loss of log-evidence."""

    parameter: str
    unit: str
    fixed: float
    value: float
    effect: str
    evidence_loss: float


def fixed_parameters_of(model: Model, parameters: ParameterSet) -> ParameterSet:
    """Parameters of a model that a fit leaves fixed and that can be searched about their value."""
    found: list[Parameter] = []
    for variable in model.parameters:
        if variable.name not in parameters.names and variable.start:
            with suppress(InputError):
                found += parameters_from_model(model, [variable.name])
    return ParameterSet(tuple(found[:MAX_PARAMETERS]))


def find_alternatives(
    cache: ModelCache, explored: SearchResult, chosen: FittedModel, settings: LoopSettings
) -> tuple[FixedValueAlternative, ...]:
    """Find, for each chosen term, fixed parameters that could replace it without a loss of evidence.

    The sensitivity to each fixed parameter predicts its gain to first order; the likeliest are fitted."""
    plain = cache.source.plain
    fixed = fixed_parameters_of(cache.source.family.base_model(), plain.parameters)
    if not fixed or not chosen.terms:
        return ()
    extended, found = cache.beside(fixed), list[FixedValueAlternative]()
    for id_ in chosen.terms:
        start = explored.fits.get(chosen.structure.minus(id_), chosen)
        with suppress(CannotFinishError):
            found += _alternatives_to(extended, chosen, id_, start.values, fixed, settings)
    extended.close()
    return tuple(found)


def _alternatives_to(
    extended: ModelCache,
    chosen: FittedModel,
    id_: str,
    start: Mapping[str, float],
    fixed: ParameterSet,
    settings: LoopSettings,
) -> list[FixedValueAlternative]:
    """Fixed parameters that do as well as a term; the fit without it begins at the values ``start``."""
    fit = replace(settings.local_fit, hold_noise=True)
    structure = chosen.structure.minus(id_)
    model = extended.of(structure)
    # Evidence compares under one noise only: that of the chosen structure.
    without_term = model.fit(structure, model.coordinates_of(start, structure.terms), chosen.noise, fit)
    gains = _predicted_gains(without_term, fixed)
    needed = MIN_GAIN_SHARE * without_term.temperature * (chosen.log_evidence - without_term.log_evidence)
    likely = sorted((n for n in gains if gains[n] > needed), key=lambda n: -gains[n])
    found = []
    for name in likely[:MAX_REFITS]:
        with suppress(CannotFinishError):
            end = _freed(without_term, name, fit)
            evidence_loss = chosen.log_evidence - end.log_evidence
            if evidence_loss < EQUIVALENT:
                p = fixed[name]
                found.append(FixedValueAlternative(name, p.unit, p.start, end.values[name], id_, evidence_loss))
    return found


def _freed(without_term: FittedModel, name: str, fit: LocalFitSettings) -> FittedModel:
    freed = replace(
        without_term.model,
        free_base_columns=(*without_term.model.free_base_columns, without_term.model.objective.parameters.index(name)),
    )
    return freed.fit(without_term.structure, without_term.optimum.coordinates, without_term.noise, fit)


def _predicted_gains(without_term: FittedModel, fixed: ParameterSet) -> dict[str, float]:
    """Gain in log-likelihood that the sensitivity to each of some parameters predicts."""
    parameters, names = without_term.model.objective.parameters, fixed.names
    slopes = without_term.response.readjusted_slopes(
        without_term.optimum.coordinates, [parameters.index(name) for name in names]
    )
    if slopes is None:
        return {}
    along = slopes[0] @ without_term.response.remaining
    power = np.einsum("ij,ij->i", slopes[0], slopes[0])
    return {n: float(0.5 * a * a / p) if p > 0.0 else 0.0 for n, a, p in zip(names, along, power, strict=True)}
