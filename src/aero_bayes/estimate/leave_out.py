"""Leave readings out of a fit in closed form: where it goes to first order without a block of its readings.

No simulation is needed beyond the sensitivities at the optimum. For a model that is linear in its parameters, with
normal priors, it is exact. Bands, intervals and the choice among structures all leave out by this one function.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.parameters import ParameterSet

Readings = NDArray[np.int_]

#: Least curvature, as a share of that of all readings.
MIN_CURVATURE_SHARE = 1e-12
#: Blocks of a recording, and readings that one has at least.
BLOCK_COUNT, MIN_BLOCK_READINGS = 20, 4


@dataclass(frozen=True, eq=False)
class BlockLeftOut:
    """A fit without one block of readings."""

    readings: Readings
    step: FloatArray


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """A fit to first order about its optimum."""

    slopes: FloatArray
    residual: FloatArray
    prior: FloatArray

    @classmethod
    def of(cls, optimum: Optimum, parameters: ParameterSet, moving: Sequence[int]) -> LinearisedFit:
        """Linearise an optimum over some of its free columns, given by their places among them."""
        second = parameters.prior_derivatives(optimum.coordinates)[1]
        prior = parameters.prior_curvature(second, [optimum.free[k] for k in moving])
        return cls(optimum.whitened.slopes[list(moving)], optimum.whitened.residual, prior)

    @property
    def leverage(self) -> FloatArray:
        """How much each reading determines the parameters (N,); the sum is at most their number."""
        curvature = self.slopes @ self.slopes.T + self.prior
        return np.asarray(np.einsum("kn,kn->n", self.slopes, np.linalg.pinv(curvature, hermitian=True) @ self.slopes))

    def without(
        self, cells: Sequence[Readings], windows: Sequence[slice] | None = None, least: float = MIN_CURVATURE_SHARE
    ) -> Iterator[BlockLeftOut]:
        """Leave each block out in turn.

        At the optimum the gradient of the log-posterior is zero, so that without block ``b`` it is ``-S_b r_b``, and
        the Newton step is ``-H_b^-1 S_b r_b`` with the curvature ``H_b`` of what remains."""
        slopes, residual = self.slopes, self.residual
        own = np.array([slopes[:, cell] @ slopes[:, cell].T for cell in cells])
        whole = self.prior + own.sum(axis=0)
        unit = 1.0 / np.sqrt(np.diag(whole))
        for window in windows or [slice(k, k + 1) for k in range(len(cells))]:
            block = np.concatenate(cells[window])
            # Sum the other cells: a difference would lose a direction that only this block determines.
            rest = self.prior + own[: window.start].sum(axis=0) + own[window.stop :].sum(axis=0)
            values, vectors = np.linalg.eigh(rest * np.outer(unit, unit))
            pull = vectors.T @ (unit * (slopes[:, block] @ residual[block]))
            yield BlockLeftOut(block, -unit * (vectors @ (pull / np.maximum(values, least))))


def blocks_of_time(series: Sequence[Series], leverage: FloatArray, count: int, least: int) -> list[list[Readings]]:
    """Cut the readings of each recording into blocks of time, all outputs together.

    Blocks have equal shares of readings and of leverage (N,), so that the fit without one of them is close to the full
    fit and its linearisation holds."""
    found = []
    for e in sorted({s.experiment for s in series}):
        readings = sum(s.sampling.size for s in series if s.experiment == e)
        cells = time_cells(series, leverage, e, max(min(count, readings // least), 1))
        found.append([cell for cell in cells if cell.size])
    return found


def time_cells(series: Sequence[Series], leverage: FloatArray, recording: int, count: int) -> list[Readings]:
    """Cut readings of one recording (columns of the whitened slopes) into ``count`` cells, one after the other.

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
