"""Covariance of estimates where the residual is no noise: each block of time is left out in turn.

The moving-block jackknife (Künsch, 1989, Annals of Statistics 17, 1217) asks how far the estimates move when a block of
readings is left out, for blocks that move over the recording. It assumes no model of the residual: only that blocks are
long beside its correlation time, and that one block tells little of what another holds. The number of blocks does not
grow with the number of readings, so that intervals are those of Student's t with one degree of freedom less than there
are blocks (Kiefer and Vogelsang, 2005, Econometric Theory 21, 1130).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri, stdtrit

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.leave_out import LinearisedFit, time_cells
from aero_bayes.estimate.objective import Series

#: Blocks that the readings are cut into, and steps in which a block moves by its own length.
JACKKNIFE_BLOCKS, STEPS = 10, 12
#: Least share of the information on a direction that counts as left when a block is left out: a transient that tells
#: more than half has no counterpart, and how far the estimates would move without it says nothing.
MIN_INFORMATION_LEFT = 0.5


def jackknife_covariance(series: Sequence[Series], slopes: FloatArray, residual: FloatArray) -> FloatArray:
    """Compute the covariance of least-squares estimates by leaving out moving blocks of time, all outputs together.

    Without a block the estimates move, to first order, by ``(I - S_b S_b')^-1 S_b r_b``. Blocks are whole recordings
    where there are ten or more."""
    recordings = sorted({s.experiment for s in series})
    count = max(round(STEPS * JACKKNIFE_BLOCKS / len(recordings)), STEPS)
    linear = LinearisedFit(slopes, residual, np.zeros((len(slopes), len(slopes))))
    cells = [cell for e in recordings for cell in time_cells(series, linear.leverage, e, count)]
    starts = [k * count + first for k in range(len(recordings)) for first in range(count - STEPS + 1)]
    windows = [slice(a, a + STEPS) for a in starts]
    moved = np.array([left.step for left in linear.without(cells, windows, MIN_INFORMATION_LEFT)])
    blocks = len(cells) / STEPS
    widening = float(stdtrit(blocks - 1.0, 0.95) / ndtri(0.95)) ** 2
    return np.asarray((blocks - 1.0) * widening * moved.T @ moved / len(moved))
