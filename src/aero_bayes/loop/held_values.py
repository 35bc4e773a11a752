"""Values that are held and would explain as much as an effect if they were free: a wrong one passes for physics."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.parameters import Parameter, ParameterSet, parameters_from_model
from aero_bayes.loop.attribute import Search
from aero_bayes.loop.rounds import Doubt, Selection
from aero_bayes.loop.stand import Held, Stand
from aero_bayes.simulation.model import Model

#: Share of an effect's gain that a held value must promise to be fitted, and how many are.
LIKELY, TRIED = 0.05, 3
#: Held values that are looked at; an FMU may have hundreds.
MOST = 40


def held_in(model: Model, parameters: ParameterSet) -> ParameterSet:
    """Parameters of a model that are not among those of a fit and can be searched about their value."""
    found: list[Parameter] = []
    for variable in model.parameters:
        if variable.name not in parameters.names and variable.start:
            with suppress(InputError):
                found += parameters_from_model(model, [variable.name])
    return ParameterSet(tuple(found[:MOST]))


def doubts(search: Search, selection: Selection, held: ParameterSet) -> tuple[Doubt, ...]:
    """For each effect the held values that would do as well in its place.

    A line along the sensitivity to each says which are likely; these are fitted.
    """
    if not held or not selection.effects:
        return ()
    found: list[Doubt] = []
    wider = search.stands.beside(held)
    for effect in selection.effects:
        if search.late():
            break
        alone = len(selection.effects) == 1
        without = selection.base if alone else search.without(selection.base, selection.held, effect)
        if without is not None:
            with suppress(CannotFinishError):
                found += _in_place_of(search, selection, effect, without, wider.of(selection.effects), held)
    wider.forget()
    return tuple(found)


def _in_place_of(
    search: Search, selection: Selection, effect: str, without: Held, stand: Stand, held: ParameterSet
) -> list[Doubt]:
    """The held values that do as well as an effect on a stand that has them; ``without`` is the fit without it."""
    found: list[Doubt] = []
    rest, now = without.effects, selection.held.log_evidence
    here = stand.fit(without.values, rest, without.optimum.noise, search.fit)
    promises = _promises(here, held.names)
    likely = [name for name in promises if promises[name] > LIKELY * (now - here.log_evidence)]
    for name in sorted(likely, key=lambda name: -promises[name])[:TRIED]:
        freed = replace(stand, own=(*stand.own, stand.study.parameters.index(name)))
        with suppress(CannotFinishError):
            end = freed.fit(here.values, rest, here.optimum.noise, search.fit)
            behind = now - end.log_evidence
            if behind < search.settings.equivalence:
                p = held[name]
                found.append(Doubt(name, p.unit, p.start, end.values[name], effect, behind))
    return found


def _promises(here: Held, names: Sequence[str]) -> dict[str, float]:
    """Gain in log-likelihood that a line along the sensitivity to each of some parameters foretells."""
    parameters = here.stand.study.parameters
    slopes = here.around.across(here.optimum.coordinates, [parameters.index(name) for name in names])
    if slopes is None:
        return {}
    along: NDArray[np.float64] = slopes[0] @ here.around.left
    power = np.einsum("ij,ij->i", slopes[0], slopes[0])
    return {n: float(0.5 * a * a / p) if p > 0.0 else 0.0 for n, a, p in zip(names, along, power, strict=True)}
