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

from aero_bayes.estimate.leave_out import equal_leverage_blocks, leave_blocks_out
from aero_bayes.estimate.parameters import prior_curvature
from aero_bayes.search.models import FittedModel


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
    """Blocks of a fit that are left out; see :func:`equal_leverage_blocks`."""
    optimum, objective = fitted.optimum, fitted.model.objective
    second = objective.parameters.prior_derivatives(optimum.coordinates)[1][list(optimum.free)]
    return equal_leverage_blocks(objective.series, optimum.whitened.slopes, prior_curvature(second))


def _log_density(fitted: FittedModel, blocks: Sequence[NDArray[np.int_]]) -> float:
    """Log-density of each block given all other readings, summed."""
    optimum, cold, parameters = fitted.optimum, math.sqrt(fitted.temperature), fitted.model.objective.parameters
    # Initial values and delays belong to one recording: they stay as fitted to all its readings.
    shared = [k for k, j in enumerate(optimum.free) if parameters.items[j].recording is None]
    slopes, residual = optimum.whitened.slopes[shared] / cold, optimum.whitened.residual / cold
    second = parameters.prior_derivatives(optimum.coordinates)[1][[optimum.free[k] for k in shared]]
    total = 0.0
    for left in leave_blocks_out(slopes, residual, prior_curvature(second), blocks):
        r, own = residual[left.readings], slopes[:, left.readings]
        total -= 0.5 * float(r @ r - (own @ r) @ left.step + left.log_information_lost)
    return total
