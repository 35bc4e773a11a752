"""Prediction of a block of readings from the rest, in closed form from the slopes that a fit has anyway.

One Newton step of the parameters that leaves a block out gives the residual there; no simulation is needed. For a model
that is linear in its parameters this is exact (leave-group-out cross-validation of least squares).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.search.models import FittedModel

FloatArray = NDArray[np.float64]

#: Blocks of a recording, and readings that one has at least.
BLOCKS, FEWEST = 20, 4


@dataclass(frozen=True)
class HeldOutGain:
    """Mean over blocks of the logarithm of the error without over the error with, with its standard error.

    Errors are squared whitened residuals of readings that were left out. ``blocks`` is their number; ``by`` says what
    was left out at a time.
    """

    gain: float
    standard_error: float
    blocks: int
    by: str

    @property
    def in_errors(self) -> float:
        """Gain in standard errors."""
        return self.gain / self.standard_error if self.standard_error > 0.0 else math.copysign(math.inf, self.gain)


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
    """
    recordings = {s.experiment for s in model.model.objective.series}
    whole = len(recordings) > 1
    without, with_it = (np.maximum(_losses(m, whole), 1e-300) for m in (rival, model))
    # A ratio in each block: else the blocks with the largest errors alone would decide.
    gains = np.log(without / with_it)
    spread = float(np.std(gains, ddof=1)) / math.sqrt(gains.size) if gains.size > 1 else math.inf
    return HeldOutGain(float(gains.mean()), spread, gains.size, "recordings" if whole else "blocks")


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


def _losses(fitted: FittedModel, whole: bool) -> FloatArray:
    """Half the squared whitened residual of each block when it, or its whole recording, is left out."""
    white, optimum = fitted.optimum.whitened, fitted.optimum
    parameters = fitted.model.objective.parameters
    second = parameters.prior_derivatives(optimum.coordinates)[1][list(optimum.free)]
    prior = np.diag(np.maximum(-second, 1e-9))
    low, high = (bound[list(optimum.free)] - optimum.coordinates[list(optimum.free)] for bound in parameters.box)
    losses: list[float] = []
    for experiment, blocks in _blocks(fitted):
        columns = np.concatenate(blocks)
        own = np.array([parameters.items[j].recording == experiment for j in optimum.free])
        if whole:
            left = _without(white.slopes, white.residual, columns, prior, low, high, own)
            predicted = dict(zip(columns.tolist(), left.tolist(), strict=True))
            losses += [0.5 * sum(predicted[c] ** 2 for c in block.tolist()) for block in blocks]
        else:
            none = np.zeros(len(own), dtype=bool)
            for block in blocks:
                left = _without(white.slopes, white.residual, block, prior, low, high, none)
                losses.append(0.5 * float(left @ left))
    return np.array(losses)


def _without(
    slopes: FloatArray, residual: FloatArray, block: NDArray[np.int_], prior: FloatArray, low: FloatArray,
    high: FloatArray, own: Sequence[bool] | NDArray[np.bool_],
) -> FloatArray:  # fmt: skip
    """Residual (b,) of a block that is left out; ``own`` parameters are those of its recording and follow it."""
    here, r = slopes[:, block], residual[block]
    rest = slopes @ slopes.T - here @ here.T + prior
    shared = ~np.asarray(own)
    step = np.zeros(len(shared))
    # Readings of the block no longer hold the shared parameters: the Newton step to the optimum of the others.
    inner = rest[np.ix_(shared, shared)]
    step[shared] = -np.linalg.solve(inner, here[shared] @ r)
    step = np.clip(step, low, high)
    left = r - step @ here
    if not shared.all():
        mine = here[~shared]
        follow = np.linalg.solve(mine @ mine.T + prior[np.ix_(~shared, ~shared)], mine @ left)
        left = left - follow @ mine
    return left
