"""What the posterior predicts of each fitted recording, and how likely each stretch of it was given its past."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.predictive import (
    Predictive,
    edges,
    predict_from_filter,
    predict_from_outputs,
    recording_log_density,
)
from aero_bayes.estimate.target import JointTarget
from aero_bayes.simulation.interface import Filter, Outcome


def posterior_predictive(
    joint: JointTarget,
    points: FloatArray,
    band_factors: FloatArray,
    rng: np.random.Generator,
    *,
    stored: int = 600,
    blocks: int = 2000,
) -> tuple[Predictive, ...]:
    """Predict each recording from posterior draws."""
    if joint.target.objective.filters:
        return _filtered(joint, points[:, : len(joint.target.free)], band_factors, rng, stored, blocks)
    free = len(joint.target.free)
    noise = joint.layout.unpack(points[:, free:])[:, 0]
    experiments = joint.target.calibration.data.experiments
    collected: list[list[FloatArray]] = [[] for _ in experiments]
    densities: list[list[FloatArray]] = [[] for _ in experiments]
    kept_noise: list[FloatArray] = []
    for rows, outputs, likely in _simulated(joint, points[:, :free]):
        kept_noise.append(noise[rows])
        for e, experiment in enumerate(experiments):
            measured = np.asarray(experiment.measured)
            collected[e].append(outputs[e].astype(np.float32))
            density = recording_log_density(experiment.time, measured - likely[e], noise[rows])
            bounds = edges(experiment.time.size, blocks)
            densities[e].append(np.add.reduceat(density, bounds[:-1], axis=1))
    if not kept_noise:
        raise CannotFinishError("no draw of the posterior could be simulated over the recordings")
    sd = np.concatenate(kept_noise)
    return tuple(
        predict_from_outputs(e.time, np.concatenate(y), sd, np.concatenate(density), band_factors, rng, stored, blocks)
        for e, y, density in zip(experiments, collected, densities, strict=True)
    )


def _filtered(
    joint: JointTarget, coordinates: FloatArray, factors: FloatArray, rng: np.random.Generator, stored: int, blocks: int
) -> tuple[Predictive, ...]:
    """Predict each reading from all before it, by the filter of each draw (with process noise)."""
    found = cast(Filter, joint.target.simulator).filter(joint.target.values(coordinates))
    good = np.all(found.outcomes == Outcome.OK, axis=1)
    if not good.any():
        raise CannotFinishError("no draw of the posterior could be filtered over the recordings")
    return tuple(
        predict_from_filter(e.time, np.asarray(e.measured), y[good], variance[good], factors, rng, stored, blocks)
        for e, y, variance in zip(
            joint.target.calibration.data.experiments, found.predicted, found.variance, strict=True
        )
    )  # fmt: skip


def _simulated(
    joint: JointTarget, coordinates: FloatArray, size: int = 25
) -> Iterator[tuple[NDArray[np.int64], tuple[FloatArray, ...], tuple[FloatArray, ...]]]:
    """Trajectories of a few draws at a time, and those at which the likelihood is taken, which differ where it was
    widened; draws that fail are left out."""
    spread = joint.target.spread
    for first in range(0, len(coordinates), size):
        rows = np.arange(first, min(first + size, len(coordinates)))
        result = likely = joint.target.simulator.simulate(joint.target.values(coordinates[rows]))
        if spread is not None:
            likely = joint.target.simulator.simulate(joint.target.values(spread(coordinates[rows])))
        good = np.all((result.outcomes == Outcome.OK) & (likely.outcomes == Outcome.OK), axis=1)
        if good.any():
            yield rows[good], tuple(y[good] for y in result.outputs), tuple(y[good] for y in likely.outputs)
