"""Runs of a problem in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Outcome, Problem, Trajectories
from aero_bayes.simulation.workers import WorkerPool


def ran(problem: Problem, pool: WorkerPool | None, values: ArrayLike = (), active: Any = None) -> Trajectories:
    """Run one parameter vector (p,), or rows of them (n, p)."""
    with open_simulator(problem, 0, pool) as simulator:
        return simulator.simulate(np.atleast_2d(np.asarray(values, dtype=float)), active=active)


def one_run(problem: Problem, pool: WorkerPool | None, values: tuple[float, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs (n, m) of the first experiment, which succeeds, and their slopes (n, m, p) by every target."""
    found = ran(problem, pool, values, range(len(values)))
    assert found.outcomes[0, 0] == Outcome.OK
    assert found.sensitivities is not None
    return found.outputs[0][0], found.sensitivities[0][0]
