"""Take fewer samples of an experiment."""

from __future__ import annotations

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.simulation.interface import Experiment


def rows_of_first_readings(measured: FloatArray, least: int = 20) -> int:
    """Return how many rows hold the first ``least`` readings of every output (n, m), or all that it has."""
    counts = np.cumsum(np.isfinite(measured), axis=0)
    enough = counts >= np.minimum(counts[-1], least)
    return int(np.argmax(enough, axis=0).max()) + 1 if measured.size else 0


def thin(experiment: Experiment, samples: int) -> Experiment:
    """Return the experiment on every n-th of its sample times, about ``samples`` of them.

    An output that is read less often than the others keeps up to as many readings of its own."""
    every = -(-experiment.time.size // samples)
    if every <= 1:
        return experiment
    rows = np.arange(0, experiment.time.size, every)
    if experiment.measured is not None:
        own = [np.flatnonzero(np.isfinite(column)) for column in experiment.measured.T]
        kept = np.isfinite(experiment.measured[rows]).sum(axis=0)
        seldom = [r for r, count in zip(own, kept, strict=True) if count < 0.5 * min(r.size, samples)]
        for readings in seldom:
            rows = np.union1d(rows, readings[:: -(-readings.size // samples)])
    return experiment.at_samples(rows)
