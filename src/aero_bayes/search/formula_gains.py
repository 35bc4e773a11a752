"""Gains of many candidate terms from one pass of a filter: the response to a coefficient where it is zero.

A filter of process noise knows how each state goes on to the next sample, what each reading says of the states, and
its own gain. The model has an unknown signal at each place, a state that stands still at zero. A term ``k phi`` there
moves that state, and with it the filter's predictions, by ``k`` times the response of a linear time-varying system to
``phi`` along the filter's own states, so that a term that the model has already gains nothing. So the gain of thousands
of terms needs one pass over the samples, wherever they act; states that are not recorded are no exception, and nothing
is differentiated numerically.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import prior_curvature
from aero_bayes.simulation.interface import DiffusionTarget, FilteredStates, ReadingNoiseTarget
from aero_bayes.simulation.smoothing import reading_updates

#: Share of a response that no parameter gives, below which a term is one that the model has: responses are taken along
#: straight lines between samples.
MIN_NEW_SHARE = 0.02


@dataclass(frozen=True, eq=False)
class SampledTerms:
    """Values (n, k) of terms at the samples of a recording.

    ``before`` ends the step to a sample, ``at`` is what a reading has, and ``after`` begins the next step: held inputs
    jump in between, and the filter's states are known better once it has read."""

    before: FloatArray
    at: FloatArray
    after: FloatArray

    def __truediv__(self, size: FloatArray) -> SampledTerms:
        return SampledTerms(self.before / size, self.at / size, self.after / size)


def prediction_slopes(filtered: FilteredStates, measured: FloatArray, signal: int, terms: SampledTerms) -> FloatArray:
    """Slopes of a filter's predictions by the coefficients of terms that an unknown signal is a sum of."""
    n, m = measured.shape
    change = np.zeros((filtered.mean.shape[1], terms.at.shape[1]))
    found = np.zeros((n, m, terms.at.shape[1]))
    for k in range(n):
        if k:
            change[signal] = 0.5 * (terms.after[k - 1] + terms.before[k])
            change = filtered.transition[k] @ change
        change[signal] = terms.at[k]
        updates = reading_updates(filtered, measured, k)
        for o, (h, gain, *_) in zip(np.flatnonzero(np.isfinite(measured[k])), updates, strict=True):
            moved = h @ change
            found[k, o] = moved
            change = change - np.outer(gain, moved)
    return found


def whitened_slopes(
    objective: Objective,
    fit: Optimum,
    filtered: Sequence[FilteredStates],
    signal: int,
    terms: Sequence[SampledTerms],
) -> FloatArray:
    """Slopes (k, N) of the whitened predictions of all series, by the coefficients of terms of an unknown signal."""
    calibration = objective.calibration
    slopes = [
        prediction_slopes(f, measured, signal, values)
        for f, measured, values in zip(filtered, calibration.data.measured, terms, strict=True)
    ]
    assert fit.evaluation.sd is not None
    return np.concatenate(
        [
            slopes[s.experiment][s.sampling.index, s.column].T / sd
            for s, sd in zip(objective.series, fit.evaluation.sd, strict=True)
        ],
        axis=1,
    )


@dataclass(frozen=True, eq=False)
class CoefficientGains:
    """What each of k coefficients gains once all parameters have readjusted to it."""

    gain: FloatArray
    direction: FloatArray
    value: FloatArray
    readjusted: FloatArray


def coefficient_gains(objective: Objective, fit: Optimum, slopes: FloatArray) -> CoefficientGains:
    """Return what coefficients gain, to first order."""
    # the noise is held: with less process noise than fitted it would go back at once
    noise = (DiffusionTarget, ReadingNoiseTarget)
    kept = [k for k, j in enumerate(fit.free) if not isinstance(objective.parameters.items[j].target, noise)]
    columns = [fit.free[k] for k in kept]
    own, residual = fit.whitened.slopes[kept], fit.whitened.residual
    first, second = (d[columns] for d in objective.parameters.prior_derivatives(fit.coordinates))
    curvature = fit.whitened.information[np.ix_(kept, kept)] + prior_curvature(second)
    slope = fit.whitened.score[kept] + first
    unit = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    inverse = np.linalg.pinv(curvature * np.outer(unit, unit), 1e-10, hermitian=True) * np.outer(unit, unit)
    free_step = inverse @ slope
    left = residual - free_step @ own
    before = np.linalg.norm(slopes, axis=1)
    back = (slopes @ own.T) @ inverse
    across = slopes - back @ own
    length = np.linalg.norm(across, axis=1)
    seen = length > MIN_NEW_SHARE * np.maximum(before, 1e-300)
    across = np.where(seen[:, np.newaxis], across / np.maximum(length, 1e-300)[:, np.newaxis], 0.0)
    along = across @ left
    value = np.where(seen, along / np.maximum(length, 1e-300), 0.0)
    # the rates are nearly linear in most parameters themselves, not in the logarithms in which some are searched
    si = objective.parameters.from_search(fit.coordinates)
    change = (free_step - value[:, np.newaxis] * back) * objective.parameters.jacobian(si)[columns]
    low, high = (np.array([getattr(p, end) for p in objective.parameters]) for end in ("lower", "upper"))
    readjusted = np.repeat(si[np.newaxis, :], len(slopes), axis=0)
    readjusted[:, columns] += change
    return CoefficientGains(
        0.5 * along**2 + 0.5 * float(free_step @ slope), across, value, np.clip(readjusted, low, high)
    )
