"""Values that are held and would explain as much as a chosen term if they were free: a wrong one passes for physics."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.parameters import Parameter, ParameterSet, parameters_from_model
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.search.explored import Explored
from aero_bayes.search.models import FittedModel, ModelCache
from aero_bayes.simulation.model import Model

#: Share of a term's gain that freeing a fixed parameter must predict for a refit, and the largest number of refits.
MIN_GAIN_SHARE, MAX_REFITS = 0.05, 3
#: Largest number of fixed parameters that are examined; an FMU may have hundreds.
MAX_PARAMETERS = 40


@dataclass(frozen=True)
class Doubt:
    """A value that the model holds; at ``value`` it does what a term does, but for ``behind`` in log-evidence."""

    parameter: str
    unit: str
    held: float
    value: float
    effect: str
    behind: float


def held_in(model: Model, parameters: ParameterSet) -> ParameterSet:
    """Parameters of a model that are not among those of a fit and can be searched about their value."""
    found: list[Parameter] = []
    for variable in model.parameters:
        if variable.name not in parameters.names and variable.start:
            with suppress(InputError):
                found += parameters_from_model(model, [variable.name])
    return ParameterSet(tuple(found[:MAX_PARAMETERS]))


def doubts(cache: ModelCache, explored: Explored, chosen: FittedModel, settings: LoopSettings) -> tuple[Doubt, ...]:
    """For each chosen term the held values that could replace it without a loss of evidence.

    The slope by each says which are likely; these are fitted.
    """
    plain = cache.source.plain
    held = held_in(cache.source.family.base_model(), plain.parameters)
    if not held or not chosen.terms:
        return ()
    wider, found = cache.beside(held), list[Doubt]()
    for id_ in chosen.terms:
        rest = explored.fits.get(chosen.structure.minus(id_))
        if rest is not None:
            with suppress(CannotFinishError):
                found += _in_place_of(wider, chosen, id_, rest, held, settings)
    wider.close()
    return tuple(found)


def _in_place_of(
    wider: ModelCache, chosen: FittedModel, id_: str, rest: FittedModel, held: ParameterSet, settings: LoopSettings
) -> list[Doubt]:
    """The held values that do as well as a term; ``rest`` is the fit without it."""
    fit = replace(settings.climb, hold_noise=True)
    model = wider.of(rest.structure)
    here = model.fit(rest.structure, model.at(rest.values, rest.terms), rest.noise, fit)
    promises = _promises(here, held)
    needed = MIN_GAIN_SHARE * here.temperature * (chosen.log_evidence - here.log_evidence)
    likely = sorted((n for n in promises if promises[n] > needed), key=lambda n: -promises[n])
    found = []
    for name in likely[:MAX_REFITS]:
        with suppress(CannotFinishError):
            end = _freed(here, name, fit)
            behind = chosen.log_evidence - end.log_evidence
            if behind < settings.structures.equivalence:
                p = held[name]
                found.append(Doubt(name, p.unit, p.start, end.values[name], id_, behind))
    return found


def _freed(here: FittedModel, name: str, fit: LocalFitSettings) -> FittedModel:
    freed = replace(here.model, own=(*here.model.own, here.model.objective.parameters.index(name)))
    return freed.fit(here.structure, here.optimum.coordinates, here.noise, fit)


def _promises(here: FittedModel, held: ParameterSet) -> dict[str, float]:
    """Gain in log-likelihood that the slope by each of some parameters foretells."""
    parameters, names = here.model.objective.parameters, held.names
    slopes = here.response.across(here.optimum.coordinates, [parameters.index(name) for name in names])
    if slopes is None:
        return {}
    along = slopes[0] @ here.response.left
    power = np.einsum("ij,ij->i", slopes[0], slopes[0])
    return {n: float(0.5 * a * a / p) if p > 0.0 else 0.0 for n, a, p in zip(names, along, power, strict=True)}
