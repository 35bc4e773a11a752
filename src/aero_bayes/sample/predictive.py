"""What the posterior predicts: outputs with their noise, and how likely each stretch of data was given its past."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.target import JointTarget
from aero_bayes.sensors.whitening import reading_log_density
from aero_bayes.simulation.interface import Filter, Outcome

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Predictive:
    """Predictions for one recording.

    Parameters
    ----------
    time : ndarray, shape (n,)
    lower, median, upper : ndarray, shape (n, m)
        5, 50 and 95 % of the predicted readings, noise included.
    fit_lower, fit_upper : ndarray, shape (n, m)
        5 and 95 % of the outputs without noise.
    draw_time : ndarray, shape (k,)
        Times of the stored draws (thinned).
    draws : ndarray, shape (draws, k, m)
        Predicted readings: outputs plus one draw of the noise, correlation included.
    block_edges : ndarray, shape (b + 1,)
        Times between the blocks: of one sample each, in recordings of up to two thousand.
    log_likelihood : ndarray, shape (draws, b)
        Log-density of each block's readings given all earlier ones, by the likelihood that the posterior is made of.
    """

    time: FloatArray
    lower: FloatArray
    median: FloatArray
    upper: FloatArray
    fit_lower: FloatArray
    fit_upper: FloatArray
    draw_time: FloatArray
    draws: FloatArray
    block_edges: FloatArray
    log_likelihood: FloatArray


def recording_log_density(time: FloatArray, residual: FloatArray, noise: FloatArray) -> FloatArray:
    """Log-density of all readings at a time given the earlier ones, (k, n), of residuals (k, n, m), noise (k, m, 3)."""
    out = np.zeros(residual.shape[:2])
    for j in range(residual.shape[2]):
        out += reading_log_density(time, residual[:, :, j], noise[:, j])
    return out


def posterior_predictive(
    joint: JointTarget, points: FloatArray, rng: np.random.Generator, *, stored: int = 600, blocks: int = 2000
) -> tuple[Predictive, ...]:
    """Predictions of posterior draws for each recording.

    Parameters
    ----------
    joint : JointTarget
    points : ndarray, shape (draws, d)
    rng : numpy.random.Generator
    stored : int
        Sample times of which whole draws are kept.
    blocks : int
        Blocks of equal length that a recording is cut into.

    Raises
    ------
    CannotFinishError
        If no draw can be simulated.
    """
    if joint.target.objective.filtered:
        return _filtered(joint, points[:, : len(joint.target.free)], rng, stored, blocks)
    free = len(joint.target.free)
    noise = joint.layout.unpack(points[:, free:])[:, 0]
    experiments = joint.target.calibration.experiments
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
        of_outputs(e.time, np.concatenate(y), sd, np.concatenate(density), rng, stored, blocks)
        for e, y, density in zip(experiments, collected, densities, strict=True)
    )


def of_outputs(
    time: FloatArray, outputs: NDArray[np.float32], noise: FloatArray, density: FloatArray, rng: np.random.Generator,
    stored: int, blocks: int,
) -> Predictive:  # fmt: skip
    """From simulated outputs (k, n, m), noise triples (k, m, 3) and the density of each block (k, b)."""
    sd = np.hypot(noise[:, np.newaxis, :, 0], noise[:, np.newaxis, :, 1])
    return summarise(time, outputs, sd, lambda rows: noise_draws(rng, time[rows], noise), density, stored, blocks)


def _filtered(
    joint: JointTarget, coordinates: FloatArray, rng: np.random.Generator, stored: int, blocks: int
) -> tuple[Predictive, ...]:
    """With process noise each reading is predicted from all before it, by the filter of each draw."""
    found = cast(Filter, joint.target.simulator).filter(joint.target.values(coordinates))
    good = np.all(found.outcomes == Outcome.OK, axis=1)
    if not good.any():
        raise CannotFinishError("no draw of the posterior could be filtered over the recordings")
    return tuple(
        of_readings(e.time, np.asarray(e.measured), y[good], variance[good], rng, stored, blocks)
        for e, y, variance in zip(
            joint.target.calibration.experiments, found.predicted, found.variance, strict=True
        )
    )  # fmt: skip


def of_readings(
    time: FloatArray, measured: FloatArray, predicted: FloatArray, variance: FloatArray, rng: np.random.Generator,
    stored: int, blocks: int,
) -> Predictive:  # fmt: skip
    """From predictions (k, n, m) of independent readings, and their variances."""
    density = np.nansum(-0.5 * ((measured - predicted) ** 2 / variance + np.log(2.0 * np.pi * variance)), axis=2)
    bounds = edges(time.size, blocks)
    sd = np.sqrt(variance)
    return summarise(
        time, predicted.astype(np.float32), sd, lambda rows: sd[:, rows] * rng.standard_normal(sd[:, rows].shape),
        np.add.reduceat(density, bounds[:-1], axis=1), stored, blocks,
    )  # fmt: skip


def edges(n: int, blocks: int) -> NDArray[np.int64]:
    """Rows between ``blocks`` blocks of about equal length, the ends included."""
    return np.unique(np.linspace(0, n, min(blocks, n) + 1).astype(np.int64))


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


def noise_draws(rng: np.random.Generator, time: FloatArray, noise: FloatArray) -> FloatArray:
    """Draws of the noise, shape (k, n, m), for noise triples (k, m, 3)."""
    k, m = noise.shape[:2]
    white, ou, tau = np.moveaxis(noise, 2, 0)
    out = np.empty((k, time.size, m))
    state = rng.standard_normal((k, m))
    for j in range(time.size):
        if j:
            rho = np.exp(-(time[j] - time[j - 1]) / np.where(tau > 0.0, tau, 1.0))
            state = rho * state + np.sqrt(1.0 - rho**2) * rng.standard_normal((k, m))
        out[:, j] = ou * state
    return np.asarray(out + white[:, None] * rng.standard_normal(out.shape))


def summarise(
    time: FloatArray,
    outputs: NDArray[np.float32],
    sd: FloatArray,
    noise: Callable[[NDArray[np.int64]], FloatArray],
    density: FloatArray,
    stored: int,
    blocks: int,
) -> Predictive:
    """Bands and draws of readings.

    Parameters
    ----------
    time : ndarray, shape (n,)
    outputs : ndarray, shape (k, n, m)
        Of k draws, without noise.
    sd : ndarray, shape (k, 1, m) or (k, n, m)
        Of the readings about them.
    noise : callable
        Draws of the noise, shape (k, r, m), at some r rows.
    density : ndarray, shape (k, b)
        Log-density of each block's readings.
    stored : int
        Rows of which whole draws are kept.
    blocks : int
    """
    _, n, m = outputs.shape
    lower, median, upper = np.empty((n, m)), np.empty((n, m)), np.empty((n, m))
    fit_lower, fit_upper = np.empty((n, m)), np.empty((n, m))
    variance = np.broadcast_to(np.mean(sd**2, axis=0), (n, m))
    for first in range(0, n, 4000):
        part = outputs[:, first : first + 4000].astype(np.float64)
        fit_lower[first : first + 4000], fit_upper[first : first + 4000] = np.quantile(part, [0.05, 0.95], axis=0)
        spread = 1.6448536269514722 * np.sqrt(variance[first : first + 4000] + part.var(axis=0))
        centre = part.mean(axis=0)
        median[first : first + 4000] = centre
        lower[first : first + 4000], upper[first : first + 4000] = centre - spread, centre + spread
    chosen = np.unique(np.linspace(0, n - 1, min(stored, n)).astype(np.int64))
    draws = outputs[:, chosen].astype(np.float64) + noise(chosen)
    bounds = edges(n, blocks)
    return Predictive(
        time, lower, median, upper, fit_lower, fit_upper, time[chosen], draws,
        time[np.minimum(bounds, n - 1)], density,
    )  # fmt: skip
