"""Leave-one-out in closed form: where a fit goes to first order when a block of its readings is left out.

No simulation is needed beyond the sensitivities at the optimum. For a model that is linear in its parameters, with
normal priors, it is exact.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.objective import Series

FloatArray = NDArray[np.float64]
Readings = NDArray[np.int_]

#: Least curvature, as a share of that of all readings.
MIN_CURVATURE_SHARE = 1e-12
#: Blocks of a recording, and readings that one has at least.
BLOCK_COUNT, MIN_BLOCK_READINGS = 20, 4


@dataclass(frozen=True, eq=False)
class BlockLeftOut:
    """A fit without one block of readings.

    Parameters
    ----------
    readings : ndarray of int
        Columns of the whitened slopes that were left out.
    step : ndarray, shape (k,)
        Change of the parameters' search coordinates, by one Newton step.
    log_information_lost : float
        Log-determinant of the curvature of the log-posterior with the block, less that without it.
    """

    readings: Readings
    step: FloatArray
    log_information_lost: float


def equal_leverage_blocks(
    series: Sequence[Series], slopes: FloatArray, prior: FloatArray, least: int = MIN_BLOCK_READINGS
) -> list[list[Readings]]:
    """Readings (columns of the whitened slopes) by recording, and in each by block of time, all outputs together.

    Blocks have equal leverage, so that the fit without one of them is close to the full fit and its linearisation
    holds. A transient that determines most parameters is thus cut into many blocks.

    Parameters
    ----------
    series : sequence of Series
    slopes : ndarray, shape (k, N)
        Whitened, all series end to end.
    prior : ndarray, shape (k, k)
        Curvature of the negative log-prior.
    least : int
        Readings of a block on average, at least.
    """
    leverage = np.einsum("kn,kn->n", slopes, np.linalg.solve(slopes @ slopes.T + prior, slopes))
    found = []
    for e in sorted({s.experiment for s in series}):
        readings = sum(s.sampling.size for s in series if s.experiment == e)
        cells = time_cells(series, leverage, e, max(min(BLOCK_COUNT, readings // least), 1))
        found.append([cell for cell in cells if cell.size])
    return found


def time_cells(series: Sequence[Series], leverage: FloatArray, recording: int, count: int) -> list[Readings]:
    """Readings of one recording (columns of the whitened slopes) in ``count`` cells that follow each other in time.

    Each cell holds the same sum of the number of readings and of their leverage (N,), both as shares of the
    recording's. So no cell is empty unless one reading outweighs it, and a transient that tells much is cut into many.
    """
    first = np.concatenate(([0], np.cumsum([s.sampling.size for s in series])))
    own = [k for k, s in enumerate(series) if s.experiment == recording]
    columns = np.concatenate([np.arange(first[k], first[k + 1]) for k in own])
    columns = columns[np.argsort(np.concatenate([series[k].sampling.time for k in own]), kind="stable")]
    share = leverage[columns] / max(float(leverage[columns].sum()), 1e-300) + 1.0 / columns.size
    cell = np.minimum((np.cumsum(share) - 0.5 * share) / share.sum() * count, count - 1).astype(np.int64)
    edges = np.searchsorted(cell, np.arange(count + 1)).tolist()
    return [columns[a:b] for a, b in pairwise(edges)]


def leave_blocks_out(
    slopes: FloatArray, residual: FloatArray, prior: FloatArray, blocks: Sequence[Readings]
) -> Iterator[BlockLeftOut]:
    """Leave each block out in turn.

    At the optimum the gradient of the log-posterior is zero, so that without block ``b`` it is ``-S_b r_b``, and the
    Newton step is ``-H_b^-1 S_b r_b`` with the curvature ``H_b`` of what remains.

    Parameters
    ----------
    slopes : ndarray, shape (k, N)
        Whitened sensitivities of the parameters that all blocks share.
    residual : ndarray, shape (N,)
        Whitened.
    prior : ndarray, shape (k, k)
        Curvature of the negative log-prior.
    blocks : sequence of ndarray of int
        Together all readings.
    """
    own = [slopes[:, block] @ slopes[:, block].T for block in blocks]
    whole = prior + sum(own)
    unit = 1.0 / np.sqrt(np.diag(whole))
    volume = float(np.log(_spectrum(whole, unit)[0]).sum())
    for k, block in enumerate(blocks):
        # Sum the other blocks: a difference would lose a direction that only this block determines.
        values, vectors = _spectrum(prior + sum(own[:k] + own[k + 1 :]), unit)
        pull = vectors.T @ (unit * (slopes[:, block] @ residual[block]))
        yield BlockLeftOut(block, -unit * (vectors @ (pull / values)), volume - float(np.log(values).sum()))


def _spectrum(curvature: FloatArray, unit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and eigenvectors of a curvature in units of its parameters; bounded below by rounding."""
    values, vectors = np.linalg.eigh(curvature * np.outer(unit, unit))
    return np.maximum(values, MIN_CURVATURE_SHARE), vectors
