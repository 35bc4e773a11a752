"""Outputs that are read as means over an interval: a simulator of runs on a finer grid, averaged.

Each mean is a Gauss-Legendre sum over its interval, exact for polynomials of degree nine: an output is smooth where
inputs change at the ends of intervals only, as inputs do that are means themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import ClosedAtExit, Experiment, Problem, Simulator, Trajectories

#: Places in (-1, 1) and weights, which sum to one.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
WEIGHTS = 0.5 * WEIGHTS


@dataclass(frozen=True, eq=False)
class _Grid:
    """A finer grid of an experiment: the rows of its samples, and those of the nodes (n, k) by column."""

    time: FloatArray
    samples: NDArray[np.intp]
    nodes: dict[int, NDArray[np.intp]]

    @classmethod
    def of(cls, experiment: Experiment) -> Self:
        own = {}
        asked = {o: windows for o, windows in experiment.windows.items() if o in experiment.outputs}
        for output, windows in asked.items():
            begin, end = np.clip(windows, experiment.time[0], experiment.time[-1]).T[:, :, np.newaxis]
            own[experiment.outputs.index(output)] = 0.5 * (begin + end) + 0.5 * (end - begin) * NODES
        time = np.unique(np.concatenate([experiment.time, *(places.ravel() for places in own.values())]))
        rows = {column: np.searchsorted(time, places) for column, places in own.items()}
        return cls(time, np.searchsorted(time, experiment.time), rows)

    def averaged(self, fine: FloatArray) -> FloatArray:
        """Return values (n, time, m, ...) at the samples, with means in the columns that have them."""
        found = fine[:, self.samples].copy()
        for column, rows in self.nodes.items():
            found[:, :, column] = np.einsum("k,ntk...->nt...", WEIGHTS, fine[:, rows, column])
        return found


class AveragingSimulator(ClosedAtExit):
    """Runs a problem some of whose outputs are means, by the simulator that ``opened`` returns of its finer grid."""

    def __init__(self, problem: Problem, opened: Callable[[Problem], Simulator]) -> None:
        if problem.process is not None:
            raise InputError(f"{problem.model.path}: readings that are means know no process noise")
        self.problem = problem
        self.grids = [_Grid.of(e) for e in problem.experiments]
        fine = tuple(
            replace(e, time=grid.time, measured=None, spread=None, windows={})
            for e, grid in zip(problem.experiments, self.grids, strict=True)
        )
        self.inner = opened(replace(problem, experiments=fine))

    def close(self) -> None:
        """Close the simulator of the finer grid."""
        self.inner.close()

    def simulate(self, values: FloatArray, *, active: Sequence[int] | None = None) -> Trajectories:
        """Trajectories; with ``active`` also sensitivities to those columns. See :class:`Simulator`."""
        found = self.inner.simulate(values, active=active)
        outputs = tuple(grid.averaged(y) for grid, y in zip(self.grids, found.outputs, strict=True))
        slopes = found.sensitivities
        if slopes is not None:
            slopes = tuple(grid.averaged(s) for grid, s in zip(self.grids, slopes, strict=True))
        return replace(found, outputs=outputs, sensitivities=slopes)
