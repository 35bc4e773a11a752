"""Prediction of a block of readings from the rest, in closed form from the slopes that a fit has anyway.

One Newton step of the parameters that leaves a block out gives the residual there; no simulation is needed. For a model
that is linear in its parameters this is exact (leave-group-out cross-validation of least squares).
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
    With whitened residuals ``a`` of the rival and ``b`` of the model where each reading was left out, the gain is
    ``(a'a - b'b) / 2`` and its variance under the noise ``|a - b|^2``, both over the temperature. A term that acts in
    few blocks is told by these; its parameters must be told by the other blocks.
    """
    recordings = {s.experiment for s in model.model.objective.series}
    whole = len(recordings) > 1
    one, other = _left_out(rival, whole), _left_out(model, whole)
    gain = 0.5 * float(one @ one - other @ other) / model.temperature
    spread = float(np.linalg.norm(one - other)) / math.sqrt(model.temperature)
    count = len(recordings) if whole else len(_blocks(model)[0][1])
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


def _left_out(fitted: FittedModel, whole: bool) -> FloatArray:
    """Whitened residual (N,) of each reading when its block, or its whole recording, is left out."""
    white, optimum = fitted.optimum.whitened, fitted.optimum
    parameters = fitted.model.objective.parameters
    second = parameters.prior_derivatives(optimum.coordinates)[1][list(optimum.free)]
    prior = np.diag(np.maximum(-second, 1e-9))
    low, high = (bound[list(optimum.free)] - optimum.coordinates[list(optimum.free)] for bound in parameters.box)
    found = np.empty(white.residual.size)
    for experiment, blocks in _blocks(fitted):
        own = np.array([parameters.items[j].recording == experiment for j in optimum.free], dtype=bool)
        for block in [np.concatenate(blocks)] if whole else blocks:
            found[block] = _without(white.slopes, white.residual, block, prior, low, high, own)
    return found


def _without(
    slopes: FloatArray, residual: FloatArray, block: NDArray[np.int_], prior: FloatArray, low: FloatArray,
    high: FloatArray, own: NDArray[np.bool_],
) -> FloatArray:  # fmt: skip
    """Residual (b,) of a block that is left out.

    ``own`` parameters, such as the initial values of its recording, are no prediction: they follow all readings.
    """
    here, r, shared = slopes[:, block], residual[block], ~own
    whole: FloatArray = slopes @ slopes.T + prior
    rest: FloatArray = whole - here @ here.T
    follow: FloatArray = np.zeros((0, int(shared.sum())))
    if own.any():
        inside, cross = whole[np.ix_(own, own)], rest[np.ix_(own, shared)]
        follow = np.asarray(np.linalg.solve(inside, whole[np.ix_(own, shared)]))
        rest[np.ix_(shared, shared)] -= np.asarray(cross.T @ np.linalg.solve(inside, cross))
    # Readings of the block no longer hold the shared parameters: the Newton step to the optimum of the others.
    step = np.zeros(len(own))
    step[shared] = np.clip(-np.linalg.solve(rest[np.ix_(shared, shared)], here[shared] @ r), low[shared], high[shared])
    step[own] = np.clip(-(follow @ step[shared]), low[own], high[own])
    return r - step @ here
