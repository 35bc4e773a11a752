"""Prediction of a block of readings from the rest, in closed form from the slopes that a fit has anyway.

No simulation is needed. For a model that is linear in its parameters, with normal priors, it is exact: the density of a
block given all other readings is a ratio of evidences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.search.models import FittedModel

FloatArray = NDArray[np.float64]

#: Blocks of a recording, and readings that one has at least.
BLOCKS, FEWEST = 20, 4
#: Standard deviations by which the step without a block may move each parameter: farther the slopes do not hold.
FARTHEST = 3.0


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
    """How much better a model predicts what is left out than a rival, both fitted under one noise.

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
    gain = _log_density(model, whole) - _log_density(rival, whole)
    change = model.optimum.whitened.residual - rival.optimum.whitened.residual
    count = len(recordings) if whole else len(_blocks(model)[0][1])
    spread = float(np.linalg.norm(change)) / math.sqrt(model.temperature)
    return HeldOutGain(gain, spread, count, "recordings" if whole else "blocks")


def _blocks(fitted: FittedModel) -> list[tuple[int, list[NDArray[np.int_]]]]:
    """Readings (columns of the whitened slopes) by recording, and within each by block of time, outputs together."""
    series = fitted.model.objective.series
    first = np.concatenate(([0], np.cumsum([s.sampling.size for s in series])))
    found = []
    for e in sorted({s.experiment for s in series}):
        own = [k for k, s in enumerate(series) if s.experiment == e]
        times = np.concatenate([series[k].sampling.time for k in own])
        columns = np.concatenate([np.arange(first[k], first[k + 1]) for k in own])
        count = max(min(BLOCKS, min(series[k].sampling.size for k in own) // FEWEST), 1)
        edges = np.linspace(times.min(), times.max(), count + 1)
        place = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, count - 1)
        found.append((e, [columns[place == k] for k in range(count)]))
    return found


def _log_density(fitted: FittedModel, whole: bool) -> float:
    """Log-density of each block, or of each whole recording, given all other readings, summed."""
    optimum, cold = fitted.optimum, math.sqrt(fitted.temperature)
    slopes, residual = optimum.whitened.slopes / cold, optimum.whitened.residual / cold
    second = fitted.model.objective.parameters.prior_derivatives(optimum.coordinates)[1][list(optimum.free)]
    curvature = slopes @ slopes.T + np.diag(np.maximum(-second, 1e-9))
    _, volume = np.linalg.slogdet(curvature)
    total = 0.0
    for _, blocks in _blocks(fitted):
        for block in [np.concatenate(blocks)] if whole else blocks:
            here, r = slopes[:, block], residual[block]
            rest, pull = curvature - here @ here.T, here @ r
            _, without = np.linalg.slogdet(rest)
            tension = min(float(pull @ np.linalg.solve(rest, pull)), FARTHEST**2 * len(optimum.free))
            total -= 0.5 * (float(r @ r) + tension + float(volume - without))
    return total
