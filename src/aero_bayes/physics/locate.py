"""Where in the physics does the residual enter: the unknown signal at each port that would explain all outputs.

A port's signal is a Gaussian process over time with unknown size and smoothness, driven through the exact
sensitivities of the probe model, while the fitted parameters may readjust linearly. Its marginal likelihood, at the
best size and smoothness, is how well the port alone explains every output at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """Whitened residual and what can answer it.

    Parameters
    ----------
    residual : ndarray, shape (N,)
    nuisance : ndarray, shape (k, N)
        Sensitivities to parameters that are refitted, scaled so that each has a standard normal prior (or rows that
        are large against that).
    """

    residual: FloatArray
    nuisance: FloatArray

    def project(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gram matrix (q, q) and score (q,) of rows (q, N) with the nuisance directions marginalised."""
        gram, score = rows @ rows.T, rows @ self.residual
        if self.nuisance.size == 0:
            return gram, score
        inner = self.nuisance @ self.nuisance.T + np.eye(self.nuisance.shape[0])
        cross = rows @ self.nuisance.T
        solved = np.linalg.solve(inner, np.column_stack([cross.T, self.nuisance @ self.residual]))
        return gram - cross @ solved[:, :-1], score - cross @ solved[:, -1]


@dataclass(frozen=True, eq=False)
class PortSignal:
    """The signal at one port that explains the residual best.

    ``gain`` is the log-evidence over no signal; ``time``, ``values``, ``sd`` have shape (k,), in the port's unit.
    """

    port: str
    gain: float
    size: float
    smoothness: float
    time: FloatArray
    values: FloatArray
    sd: FloatArray


def kernel(time: FloatArray, length: float) -> FloatArray:
    """Matern 3/2 correlation between times (k,): continuous signals with a slope."""
    scaled = math.sqrt(3.0) * np.abs(time[:, np.newaxis] - time[np.newaxis, :]) / length
    return (1.0 + scaled) * np.exp(-scaled)


def posterior_signal(gram: FloatArray, score: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the amplitudes, shape (k,) each."""
    lower = _root(covariance)
    inner = np.eye(lower.shape[1]) + lower.T @ gram @ lower
    mean = lower @ np.linalg.solve(inner, lower.T @ score)
    spread = np.linalg.solve(np.linalg.cholesky(inner), lower.T)
    return mean, np.sqrt(np.sum(spread**2, axis=0))


def infer_signal(
    port: str,
    time: FloatArray,
    responses: FloatArray,
    linear: LinearResponse,
    lengths: Sequence[float],
    sizes: Sequence[float] | None = None,
) -> PortSignal:
    """Most likely signal at one port.

    Parameters
    ----------
    time : ndarray, shape (k,)
        Knots of the signal in s; straight lines between.
    responses : ndarray, shape (k, N)
        Whitened response of all outputs to one unit at each knot.
    lengths, sizes : sequences of float
        Correlation lengths (s) and standard deviations (in the port's unit) to choose from; by default the sizes are
        spread around that at which the responses are as large as the noise.
    """
    gram, score = linear.project(responses)
    unit = 1.0 / math.sqrt(max(float(np.trace(gram)) / max(time.size, 1), 1e-300))
    choices = tuple(sizes) if sizes is not None else tuple(unit * 3.0**k for k in range(-3, 11))
    best: tuple[float, float, float] = (0.0, 0.0, float(lengths[0]))
    for length in lengths:
        lower = np.linalg.cholesky(kernel(time, length) + 1e-8 * np.eye(time.size))
        # One eigendecomposition serves all sizes.
        values, vectors = np.linalg.eigh(lower.T @ gram @ lower)
        values = np.maximum(values, 0.0)
        along = vectors.T @ (lower.T @ score)
        for size in choices:
            inner = 1.0 + size**2 * values
            gain = 0.5 * float(np.sum(size**2 * along**2 / inner)) - 0.5 * float(np.sum(np.log(inner)))
            if gain > best[0]:
                best = (gain, size, length)
    gain, size, length = best
    if size == 0.0:
        return PortSignal(port, 0.0, 0.0, length, time, np.zeros(time.size), np.zeros(time.size))
    mean, sd = posterior_signal(gram, score, size**2 * kernel(time, length))
    return PortSignal(port, gain, size, length, time, mean, sd)


@dataclass(frozen=True)
class Moment:
    """A disturbance tied to a window of time: at which port, from when to when (s), how large, what it gains."""

    port: str
    start: float
    stop: float
    size: float
    gain: float


def find_moment(
    port: str,
    time: FloatArray,
    responses: FloatArray,
    linear: LinearResponse,
    longest: int = 8,
    prior_size: float = 0.0,
) -> Moment | None:
    """The constant signal over a few neighbouring knots that explains most, its place paid for.

    ``prior_size`` is the standard deviation expected of its size; by default that of a signal which would be seen
    at thirty times the noise.
    """
    gram, score = linear.project(responses)
    sums, total = np.cumsum(np.pad(gram, ((1, 0), (1, 0))), axis=0).cumsum(axis=1), np.cumsum(np.pad(score, (1, 0)))
    best: Moment | None = None
    windows = time.size * min(longest, time.size)
    for length in range(1, min(longest, time.size) + 1):
        first = np.arange(time.size - length + 1)
        last = first + length
        power = sums[last, last] - sums[first, last] - sums[last, first] + sums[first, first]
        along = total[last] - total[first]
        power = np.maximum(power, 1e-12 * max(float(power.max(initial=0.0)), 1e-300))
        spread = prior_size**2 if prior_size > 0.0 else 900.0 / power
        gains = 0.5 * (along**2 * spread / (1.0 + spread * power) - np.log1p(spread * power)) - math.log(windows)
        k = int(np.argmax(gains))
        if best is None or gains[k] > best.gain:
            step = float(np.median(np.diff(time))) if time.size > 1 else 0.0
            best = Moment(
                port, float(time[first[k]]) - 0.5 * step, float(time[last[k] - 1]) + 0.5 * step,
                float(along[k] / power[k]), float(gains[k]),
            )  # fmt: skip
    return best


def rank_ports(signals: Mapping[str, PortSignal], tie: float = 3.0) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Ports by gain, best first, and those within ``tie`` of the best, which the data cannot tell apart."""
    order = tuple(sorted(signals, key=lambda port: -signals[port].gain))
    if not order or signals[order[0]].gain <= 0.0:
        return order, ()
    best = signals[order[0]].gain
    return order, tuple(port for port in order if signals[port].gain > best - tie)


def _root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray(vectors[:, keep] * np.sqrt(values[keep]))
