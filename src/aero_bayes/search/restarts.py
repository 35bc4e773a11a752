"""Restart the fits of the best structures of a level, before further terms are added.

A term that is added at a local optimum may compensate for that optimum instead of describing a missing effect.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.progressive_horizon import fit_progressive_horizon
from aero_bayes.estimate.search_settings import GlobalSearchSettings
from aero_bayes.search.models import FittedModel


class Restart(Protocol):
    """Looks for a better optimum of the same structure."""

    def refit(self, fitted: FittedModel, settings: LocalFitSettings) -> FittedModel | None:
        """A fit from another start under the same noise, better or not; None if there is none."""
        ...


class GrowingHorizon:
    """Fit the beginning of the recordings first, then longer and longer parts (progressive horizon).

    An oscillating or slowly decaying motion has few local optima only while the recording is short.
    Parameters of the first model that ended on a bound begin at their starting values.
    """

    def refit(self, fitted: FittedModel, settings: LocalFitSettings) -> FittedModel | None:
        model, known = fitted.model, fitted.optimum.coordinates
        start = model.objective.parameters.revived(known, model.own)
        try:
            free = model.free(fitted.terms)
            point, _ = fit_progressive_horizon(
                model.objective, start, free, settings.with_limits(25, 0.01), model.open, known
            )
            return model.fit(fitted.structure, point, fitted.noise, settings)
        except CannotFinishError:
            return None


class SwarmRestart:
    """The global search of ``fit``: a particle swarm over the whole box, then local fits from its best particles.

    Parameters
    ----------
    settings : GlobalSearchSettings
        Of the search; without a swarm there is no restart.
    seed : int
    """

    def __init__(self, settings: GlobalSearchSettings, seed: int) -> None:
        self._settings, self._seed = settings, seed

    def refit(self, fitted: FittedModel, settings: LocalFitSettings) -> FittedModel | None:
        if self._settings.swarm is None:
            return None
        model = fitted.model
        start = model.objective.parameters.from_search(fitted.optimum.coordinates)
        items = model.objective.parameters.with_start(start)
        objective = model.objective.with_calibration(
            replace(model.objective.calibration, parameters=items), model.objective.simulator
        )
        search = replace(self._settings, cost="weighted", staged=False, check_noise=False)
        try:
            found = GlobalSearch(objective, search).run(
                model.free(fitted.terms), model.open, np.random.default_rng(self._seed)
            )
            return model.fit(fitted.structure, found.optimum.coordinates, fitted.noise, settings)
        except CannotFinishError:
            return None
