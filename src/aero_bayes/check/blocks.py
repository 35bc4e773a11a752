"""Log-densities of blocks of time, each given everything before it, for time-ordered cross-validation.

With noise that is white plus Ornstein-Uhlenbeck the density of a recording factorises over its samples by a scalar
Kalman filter. The factor of a block is the density of its readings given all earlier ones of the same recording.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.target import JointTarget
from aero_bayes.sensors import reading_log_density
from aero_bayes.simulation.interface import Outcome

#: Largest number of simulated values in memory.
_MAX_TRAJECTORY_NUMBERS = 4_000_000


def block_edges(joint: JointTarget, blocks: int) -> tuple[FloatArray, ...]:
    """Return times that split each recording into blocks of equal length, each shape (blocks + 1,)."""
    return tuple(np.linspace(e.time[0], e.time[-1], blocks + 1) for e in joint.target.calibration.data.experiments)


def block_log_likelihood(joint: JointTarget, points: FloatArray, edges: Sequence[FloatArray]) -> list[FloatArray]:
    """Compute the log-density of every block of every recording given the readings before it."""
    experiments = joint.target.calibration.data.experiments
    size = sum(e.time.size * len(e.outputs) for e in experiments)
    batch = max(1, _MAX_TRAJECTORY_NUMBERS // size)
    parts = [_batch(joint, points[k : k + batch], edges) for k in range(0, len(points), batch)]
    return [np.concatenate([part[e] for part in parts]) for e in range(len(experiments))]


def _batch(joint: JointTarget, points: FloatArray, edges: Sequence[FloatArray]) -> list[FloatArray]:
    target, f = joint.target, len(joint.target.free)
    result = target.simulator.simulate(target.values(points[:, :f]))
    noise = joint.layout.unpack(points[:, f:])[:, 0]
    found = []
    for e, experiment in enumerate(target.calibration.data.experiments):
        measured, count = target.calibration.data.measured[e], edges[e].size - 1
        block = np.clip(np.searchsorted(edges[e], experiment.time, side="right") - 1, 0, count - 1)
        total = np.zeros((len(points), count))
        for k in range(measured.shape[1]):
            seen = np.isfinite(measured[:, k])
            if seen.any():
                residual = measured[seen, k] - result.outputs[e][:, seen, k]
                density = reading_log_density(experiment.time[seen], residual, noise[:, k])
                np.add.at(total.T, block[seen], density.T)
        failed = result.outcomes[:, e] != Outcome.OK
        total[failed | ~np.all(np.isfinite(total), axis=1)] = -np.inf
        found.append(total)
    return found
