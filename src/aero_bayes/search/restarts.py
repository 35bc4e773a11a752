"""Restart the fits of the best structures of a level, before further terms are added.

A term that is added at a local optimum may compensate for that optimum instead of describing a missing effect.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.progressive_horizon import fit_progressive_horizon
from aero_bayes.search.models import FittedModel
from aero_bayes.search.refit import own_noise_fits, settle


class Restart(Protocol):
    """Looks for a better optimum of the same structure."""

    def refit(self, fitted: FittedModel, settings: LocalFitSettings) -> FittedModel | None:
        """Return a fit from another start under the same noise, better or not; None if there is none."""
        ...


class GrowingHorizon:
    """Fit the beginning of the recordings first, then longer and longer parts (progressive horizon).

    An oscillating or slowly decaying motion has few local optima only while the recording is short.
    Parameters of the first model that ended on a bound begin at their starting values."""

    def refit(self, fitted: FittedModel, settings: LocalFitSettings) -> FittedModel | None:
        model, known = fitted.model, fitted.optimum.coordinates
        start = model.objective.parameters.revived(known, model.free_base_columns)
        try:
            free = model.free(fitted.terms)
            point, _ = fit_progressive_horizon(
                model.objective, start, free, settings.with_limits(25, 0.01), model.open, known
            )
            return model.fit(fitted.structure, point, fitted.noise, settings)
        except CannotFinishError:
            return None


class DeclaredValues:
    """Fit all parameters from the declared values of the first model's.

    A fit that lacks a term may have moved them far off, and the fit with the term that began there may have stayed."""

    def refit(self, fitted: FittedModel, settings: LocalFitSettings) -> FittedModel | None:
        declared = fitted.at_declared_values
        if declared is None:
            return None
        ends = own_noise_fits(fitted, fitted.structure, [declared.optimum.coordinates], settings)
        return replace(fitted, optimum=settle(replace(fitted, optimum=ends[0]), settings)) if ends else None
