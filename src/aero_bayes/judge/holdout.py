"""Leave-block-out cross-validation in closed form, from the sensitivities of a fit.

No simulation is needed. For a model that is linear in its parameters, with normal priors, it is exact: the density of a
block given all other readings is a ratio of evidences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.parameters import prior_curvature
from aero_bayes.search.models import FittedModel

FloatArray = NDArray[np.float64]

#: Least curvature, as a share of what all readings tell.
MIN_CURVATURE_SHARE = 1e-12
#: Blocks of a recording, and readings that one has at least.
BLOCK_COUNT, MIN_BLOCK_READINGS = 20, 4


@dataclass(frozen=True)
class HeldOutGain:
    """Gain in log-density of readings that were left out, with its standard error.

    ``blocks`` is the number of parts that were left out one at a time, ``by`` what they are.
    """

    gain: float
    standard_error: float
    blocks: int
    by: str

    @property
    def in_errors(self) -> float:
        """Gain in standard errors."""
        return self.gain / self.standard_error if self.standard_error > 0.0 else 0.0


def held_out_gain(model: FittedModel, rival: FittedModel) -> HeldOutGain:
    """Gain of a model over a rival in predicting left-out data, both fitted under one noise.

    Parameters
    ----------
    model, rival : FittedModel
        Fitted to the same readings.

    Returns
    -------
    HeldOutGain
        Left out are blocks of time; where there are several recordings, one of these at a time.

    Notes
    -----
    With whitened residual ``r`` and slopes ``S`` of a block at the fit, the curvature ``H`` of the log-posterior, and
    ``H_b`` that without the block, the log-density of the block given the rest is
    ``-(r'r + r'S' H_b^-1 S r + log(det H / det H_b)) / 2``. A parameter that only the block tells costs no more than
    its uncertainty. The variance of the gain under the noise is the squared change of the residual. Log-densities are
    over the temperature.
    """
    recordings = {s.experiment for s in model.model.objective.series}
    whole = len(recordings) > 1
    blocks = [np.concatenate(own) for own in blocks_of(model)] if whole else blocks_of(model)[0]
    gain = _log_density(model, blocks) - _log_density(rival, blocks)
    change = model.optimum.whitened.residual - rival.optimum.whitened.residual
    spread = float(np.linalg.norm(change)) / math.sqrt(model.temperature)
    return HeldOutGain(gain, spread, len(blocks), "recordings" if whole else "blocks")


def blocks_of(fitted: FittedModel) -> list[list[NDArray[np.int_]]]:
    """Readings (columns of the whitened slopes) by recording, and in each by block of time, all outputs together.

    Blocks have equal leverage, so that the fit without one of them is close to the full fit and its linearisation
    holds. A transient that determines most parameters is thus cut into many blocks.
    """
    slopes, parameters = fitted.optimum.whitened.slopes, fitted.model.objective.parameters
    second = parameters.prior_derivatives(fitted.optimum.coordinates)[1][list(fitted.optimum.free)]
    curvature = slopes @ slopes.T + prior_curvature(second)
    leverage = np.einsum("kn,kn->n", slopes, np.linalg.solve(curvature, slopes))
    series = fitted.model.objective.series
    first = np.concatenate(([0], np.cumsum([s.sampling.size for s in series])))
    found = []
    for e in sorted({s.experiment for s in series}):
        own = [k for k, s in enumerate(series) if s.experiment == e]
        columns = np.concatenate([np.arange(first[k], first[k + 1]) for k in own])
        columns = columns[np.argsort(np.concatenate([series[k].sampling.time for k in own]), kind="stable")]
        count = max(min(BLOCK_COUNT, columns.size // MIN_BLOCK_READINGS), 1)
        # Half by leverage and half by number, so that no block is empty.
        share = leverage[columns] / max(float(leverage[columns].sum()), 1e-300) + 1.0 / columns.size
        place = np.minimum((np.cumsum(share) - 0.5 * share) / 2.0 * count, count - 1).astype(int)
        found.append([columns[place == k] for k in range(count) if np.any(place == k)])
    return found


def _log_density(fitted: FittedModel, blocks: Sequence[NDArray[np.int_]]) -> float:
    """Log-density of each block given all other readings, summed."""
    optimum, cold, parameters = fitted.optimum, math.sqrt(fitted.temperature), fitted.model.objective.parameters
    # Initial values and delays belong to one recording: they stay as fitted to all its readings.
    shared = [k for k, j in enumerate(optimum.free) if parameters.items[j].recording is None]
    slopes, residual = optimum.whitened.slopes[shared] / cold, optimum.whitened.residual / cold
    second = parameters.prior_derivatives(optimum.coordinates)[1][[optimum.free[k] for k in shared]]
    prior = prior_curvature(second)
    own = [slopes[:, block] @ slopes[:, block].T for block in blocks]
    whole = prior + sum(own)
    unit = 1.0 / np.sqrt(np.diag(whole))
    volume = float(np.log(_spectrum(whole, unit)[0]).sum())
    total = 0.0
    for k, block in enumerate(blocks):
        r = residual[block]
        # Sum the other blocks: a difference would lose a direction that only this block determines.
        values, vectors = _spectrum(prior + sum(own[:k] + own[k + 1 :]), unit)
        pull = vectors.T @ (unit * (slopes[:, block] @ r))
        total -= 0.5 * float(r @ r + pull @ (pull / values) + volume - np.log(values).sum())
    return total


def _spectrum(curvature: FloatArray, unit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and eigenvectors of a curvature in units of its parameters; bounded below by rounding."""
    values, vectors = np.linalg.eigh(curvature * np.outer(unit, unit))
    return np.maximum(values, MIN_CURVATURE_SHARE), vectors
