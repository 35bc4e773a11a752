"""Predicted readings from draws of a posterior: centre, bands, and the density of what was read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.sensors.whitening import reading_log_density


@dataclass(frozen=True, eq=False)
class Predictive:
    """Predictions for one recording."""

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
    """Compute the log-density (k, n) of readings given earlier ones, of residuals (k, n, m), noise (k, m, 3)."""
    out = np.zeros(residual.shape[:2])
    for j in range(residual.shape[2]):
        out += reading_log_density(time, residual[:, :, j], noise[:, j])
    return out


def edges(n: int, blocks: int) -> NDArray[np.int64]:
    """Cut rows into ``blocks`` blocks of about equal length; returns the edges, the ends included."""
    return np.unique(np.linspace(0, n, min(blocks, n) + 1).astype(np.int64))


def _noise_draws(rng: np.random.Generator, time: FloatArray, noise: FloatArray) -> FloatArray:
    """Draw noise, shape (k, n, m), for noise triples (k, m, 3)."""
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


def predict_from_outputs(
    time: FloatArray, outputs: NDArray[np.float32], noise: FloatArray, density: FloatArray, factors: FloatArray,
    rng: np.random.Generator, stored: int, blocks: int,
) -> Predictive:  # fmt: skip
    """Predict readings from simulated outputs (k, n, m), noise triples (k, m, 3) and densities of blocks (k, b)."""
    sd = np.hypot(noise[:, np.newaxis, :, 0], noise[:, np.newaxis, :, 1])
    return _summarise(
        time, outputs, sd, lambda rows: _noise_draws(rng, time[rows], noise), density, factors, stored, blocks
    )


def predict_from_filter(
    time: FloatArray, measured: FloatArray, predicted: FloatArray, variance: FloatArray, factors: FloatArray,
    rng: np.random.Generator, stored: int, blocks: int,
) -> Predictive:  # fmt: skip
    """Predict readings from a filter's predictions (k, n, m) of independent readings, and their variances."""
    density = np.nansum(-0.5 * ((measured - predicted) ** 2 / variance + np.log(2.0 * np.pi * variance)), axis=2)
    bounds = edges(time.size, blocks)
    sd = np.sqrt(variance)
    return _summarise(
        time, predicted.astype(np.float32), sd, lambda rows: sd[:, rows] * rng.standard_normal(sd[:, rows].shape),
        np.add.reduceat(density, bounds[:-1], axis=1), factors, stored, blocks,
    )  # fmt: skip


def _summarise(
    time: FloatArray,
    outputs: NDArray[np.float32],
    sd: FloatArray,
    noise: Callable[[NDArray[np.int64]], FloatArray],
    density: FloatArray,
    factors: FloatArray,
    stored: int,
    blocks: int,
) -> Predictive:
    """Summarise readings by bands and draws."""
    _, n, m = outputs.shape
    lower, median, upper = np.empty((n, m)), np.empty((n, m)), np.empty((n, m))
    fit_lower, fit_upper = np.empty((n, m)), np.empty((n, m))
    variance = np.broadcast_to(np.mean(sd**2, axis=0), (n, m))
    for first in range(0, n, 4000):
        part = outputs[:, first : first + 4000].astype(np.float64)
        fit_lower[first : first + 4000], fit_upper[first : first + 4000] = np.quantile(part, [0.05, 0.95], axis=0)
        spread = factors * np.sqrt(variance[first : first + 4000] + part.var(axis=0))
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
