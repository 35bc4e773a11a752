"""Local fits of one structure from several starts."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.levenberg_marquardt import Stop
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.search.models import FitNoise, FittedModel
from aero_bayes.search.settings import StructureSettings
from aero_bayes.search.starts import Start
from aero_bayes.search.structure import Structure

#: Distance below the evidence that a fit has to reach up to which the fit is continued, in log-evidence.
TARGET_SLACK = 20.0


def aim_at(like: FittedModel, log_evidence: float) -> float:
    """The cost at which a fit with the Occam factor of another has a log-evidence."""
    return like.temperature * (like.log_evidence - log_evidence + TARGET_SLACK) - like.optimum.log_likelihood


def refit(
    base: FittedModel, structure: Structure, starts: Sequence[Start], settings: StructureSettings, fit: LocalFitSettings
) -> Optimum | None:
    """The best local fit of a structure on the model of ``base``.

    The first ``settings.starts`` starts are followed. A fit that converges to an optimum that an earlier start led to
    is stopped.
    """
    free, objective = base.model.free(structure.terms), base.model.objective
    ends: list[Optimum] = []
    for start in starts[: settings.starts]:
        with suppress(CannotFinishError):
            end = local_fit(objective, start.point, free, noise=base.optimum.noise, settings=fit, known=ends)
            if end.reason is not Stop.KNOWN_OPTIMUM:
                ends.append(end)
    return max(ends, key=lambda e: replace(base, structure=structure, optimum=e).log_evidence, default=None)


def refit_from_here(fitted: FittedModel, noise: FitNoise, settings: LocalFitSettings) -> Optimum | None:
    """The optimum of a fitted structure under another noise, from where it is."""
    with suppress(CannotFinishError):
        return fitted.refitted(noise, settings).optimum
    return None
