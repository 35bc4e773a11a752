"""Local fits of one structure from several starts."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.levenberg_marquardt import Stop
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.search.models import FitNoise, FittedModel
from aero_bayes.search.structure import Structure

#: Share of the common noise's variance that a fit leaves in an output below which that noise is a worse model's: the
#: fit stays where it is, since under that noise the priors and the other outputs would count too much.
MIN_OWN_NOISE_SHARE = 0.5


def refit(
    base: FittedModel, structure: Structure, points: Sequence[FloatArray], fit: LocalFitSettings
) -> Optimum | None:
    """Fit a structure locally from several points (p,) on the model of ``base``; the best, under its noise.

    Where all end below ``base``, which is a part of the structure, the fit begins there, new terms off."""
    ends = own_noise_fits(base, structure, points, fit)
    if all(end.log_likelihood < base.optimum.log_likelihood for end in ends):
        ends += own_noise_fits(base, structure, [base.optimum.coordinates], fit)
    found = [replace(base, structure=structure, optimum=end) for end in ends]
    best = max(found, key=lambda f: f.log_posterior, default=None)
    return settle(best, fit) if best is not None else None


def own_noise_fits(
    base: FittedModel, structure: Structure, points: Sequence[FloatArray], fit: LocalFitSettings
) -> list[Optimum]:
    """Return where local fits of a structure from several points end.

    The noise of each is the one that it leaves itself, so that the weight of the priors and of the outputs among each
    other does not depend on how bad another model is. The results are given under the noise of ``base``."""
    objective, noise = base.model.objective, base.optimum.noise
    own, ends = replace(fit.least_squares(objective.outputs), hold_noise=False), list[Optimum]()
    free = base.model.free(structure.terms)
    for point in points:
        with suppress(CannotFinishError):
            end = local_fit(objective, point, free, noise=noise, settings=own, known=ends)
            if end.reason is not Stop.KNOWN_OPTIMUM:
                ends.append(end)
    return [end.with_noise(objective, noise) for end in ends]


def settle(fitted: FittedModel, fit: LocalFitSettings) -> Optimum:
    """The optimum under the common noise, from where a fit under its own noise ended, if these do not differ much."""
    if min(fitted.squares_left().values()) < MIN_OWN_NOISE_SHARE:
        return fitted.optimum
    return refit_from_here(fitted, fitted.noise, fit) or fitted.optimum


def fit_anew(like: FittedModel, point: FloatArray, fit: LocalFitSettings) -> Optimum | None:
    """Fit the structure and the model of ``like`` from a point (p,), under its own noise and then under the common one.

    None where that fails."""
    ends = own_noise_fits(like, like.structure, [point], fit)
    return settle(replace(like, optimum=ends[0]), fit) if ends else None


def refit_from_here(fitted: FittedModel, noise: FitNoise, settings: LocalFitSettings) -> Optimum | None:
    """Return the optimum of a fitted structure under another noise, from where it is; None where that fails."""
    with suppress(CannotFinishError):
        return fitted.refitted(noise, settings).optimum
    return None
