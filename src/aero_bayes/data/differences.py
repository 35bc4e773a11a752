"""Differences of readings, and the variances of noise and signal in them.

A difference of order p at lag k removes any local polynomial of degree p - 1. Its weights are scaled so that white
noise keeps its variance. With readings x_j, the variance of the difference is

- the same at every lag k for white noise;
- ``1 + 2 sum_j (-1)^j C(2p, p + j) / C(2p, p) r^j`` with r = exp(-k dt / tau) for an Ornstein-Uhlenbeck process;
- proportional to k for a signal that is a random walk, to k^3 for one whose slope is a random walk, and to k^2p for one
  that is smooth over the p k samples.

So the part that does not depend on the lag is white noise. The part that grows is a signal or correlated noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
import scipy  # imports its parts when they are first used
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray

LAGS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
#: Largest number of differences at each lag, evenly spread over a longer recording.
MAX_DIFFERENCES = 20_000
#: Relative difference below which two time steps count as equal.
MAX_STEP_DEVIATION = 1e-6
#: Quantile of the absolute differences above which they are trimmed: the largest are jumps of the signal.
TRIM_QUANTILE = 0.8
#: Mean square of a standard normal variable below its 80 % quantile in absolute value.
TRIMMED_NORMAL_VARIANCE = 0.4377
#: Samples after a jump of an input that are not used: the largest number that leaves ``MIN_UNDISTURBED_SHARE`` of them.
SETTLING_SAMPLES = (1000, 500, 300, 200, 100, 50, 30, 20, 10, 0)
MIN_UNDISTURBED_SHARE = 0.4
#: Lags are used up to the first whose variance is this many times that of the first lag: longer ones show the signal
#: only.
MAX_VARIANCE_RATIO = 10.0
#: Relative model error of the variance curves.
SHAPE_ERROR = 0.04
#: Gain in chi-squared of correlated noise over white noise with a smooth signal, and over a drifting signal, above
#: which correlated noise is accepted.
MIN_CHI_SQUARED_GAIN, MIN_GAIN_OVER_DRIFT = 12.0, 2.0
#: Longest correlation time, as a share of the longest lag: a longer one cannot be told from a drift.
MAX_FITTED_TAU_SHARE = 0.5
#: Lag of the inputs, in samples, up to which their differences may explain those of an output.
MAX_INPUT_LAG = 12


@dataclass(frozen=True)
class NoiseVariances:
    """Variances of noise, from differences of one order."""

    white: float
    slow: float
    memory: float
    near: float
    whole: float
    windows: int


@dataclass(frozen=True, eq=False)
class Differences:
    """Differences of readings."""

    values: FloatArray
    time: FloatArray
    inputs: Sequence[FloatArray] = ()

    def noise_variances(self, order: int) -> NoiseVariances | None:
        """Estimate variances of noise from the growth of the variance with the lag; None for too few readings."""
        lags, variances, windows, calm = self._variances(order)
        if not lags.size or lags[0] != 1.0:
            return None
        if variances[0] == 0.0:
            return NoiseVariances(0.0, 0.0, 0.0, 0.0, 0.0, windows)
        lags, variances = lags[variances > 0.0], variances[variances > 0.0]
        beyond = np.flatnonzero(variances > MAX_VARIANCE_RATIO * variances[0])
        stop = int(beyond[0]) + 1 if beyond.size else lags.size
        return _fit_noise_variances(lags[:stop], variances[:stop], order, windows, calm)

    def explained(self, order: int) -> float:
        """Compute the share of the variance of differences at the first lag that those of earlier inputs predict.

        It is the cross-validated R^2 of a regression on inputs up to ``MAX_INPUT_LAG`` samples ago: fitted on one half
        of the recording, and tested on the other. 1 if inputs move and there are too few readings."""
        weights, rows = _weights(self.time, order, 1)
        found = (weights * self.values[rows]).sum(axis=1)
        use, _ = self._undisturbed(rows, np.isfinite(found) & (rows[:, 0] >= MAX_INPUT_LAG))
        weights, rows = weights[use], rows[use]
        columns = [(weights * u[rows - back]).sum(axis=1) for u in self.inputs for back in range(MAX_INPUT_LAG)]
        columns = [column for column in columns if np.any(column)]
        if not columns:
            return 0.0
        design = np.column_stack(columns)
        design /= np.sqrt(np.mean(design**2, axis=0))
        target, half = found[use], int(use.sum()) // 2
        if half < 2 * design.shape[1]:
            return 1.0
        left = target.copy()
        for fitted, judged in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
            own = design[fitted]
            gram = own.T @ own + 1e-6 * len(own) * np.eye(own.shape[1])
            left[judged] -= design[judged] @ np.linalg.solve(gram, own.T @ target[fitted])
        whole = _trimmed(target)
        return max(1.0 - _trimmed(left) / whole, 0.0) if whole > 0.0 else 0.0

    def _variances(self, order: int) -> tuple[FloatArray, FloatArray, int, bool]:
        """Compute lags, trimmed variances, differences at the first lag, and whether inputs were constant there."""
        lags, variances, windows, rested = [], [], 0, False
        for lag in LAGS:
            if self.values.size < max(2 * order * lag, order * lag + 5):
                break
            weights, rows = _weights(self.time, order, lag)
            found = (weights * self.values[rows]).sum(axis=1)
            use, calm = self._undisturbed(rows, np.isfinite(found))
            if use.sum() < 5:
                continue
            if lag == 1:
                windows, rested = int(use.sum()), calm
            lags.append(float(lag))
            variances.append(_trimmed(found[use]))
        return np.array(lags), np.array(variances), windows, rested

    @cached_property
    def _since_jump(self) -> FloatArray:
        """Compute the time since the last jump of an input, infinite before the first."""
        jumps = input_jumps(self.time, self.inputs)
        if jumps.size == 0:
            return np.full(self.time.size, np.inf)
        last = np.searchsorted(jumps, self.time, side="right") - 1
        return np.where(last >= 0, self.time - jumps[np.maximum(last, 0)], np.inf)

    def _undisturbed(self, rows: NDArray[np.intp], usable: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], bool]:
        """Find windows (w, p + 1) without a jump of an input in or shortly before them; all, if these are too few."""
        since, interval = self._since_jump, float(np.median(np.diff(self.time)))
        length = self.time[rows[:, -1]] - self.time[rows[:, 0]]
        # Undisturbed: the last jump before the end of the window is before its start.
        calm = np.where(since[rows[:, -1]] >= length, since[rows[:, 0]] / interval, -1.0)
        for settled in SETTLING_SAMPLES:
            chosen = usable & (calm > settled)
            if chosen.sum() >= MIN_UNDISTURBED_SHARE * usable.sum():
                return chosen, True
        return usable, False


def input_jumps(time: FloatArray, inputs: Sequence[FloatArray]) -> FloatArray:
    """Find the times at which any input changes from one sample to the next by more than a hundredth of its range."""
    changed = np.zeros(time.size - 1, dtype=bool)
    for values in inputs:
        changed |= np.abs(np.diff(values)) > 0.01 * max(float(np.ptp(values)), 1e-300)
    jumps: FloatArray = time[1:][changed]
    return jumps


def _weights(time: FloatArray, order: int, lag: int) -> tuple[FloatArray, NDArray[np.intp]]:
    """Compute weights of divided differences, of norm one, and the rows that they belong to, both (w, order + 1)."""
    windows = time.size - order * lag
    first = (
        np.arange(windows)
        if windows <= MAX_DIFFERENCES
        else np.linspace(0, windows - 1, MAX_DIFFERENCES).astype(np.intp)
    )
    rows = first[:, None] + lag * np.arange(order + 1)
    steps = np.diff(time)
    if np.ptp(steps) < MAX_STEP_DEVIATION * steps.min():
        row = np.array([(-1.0) ** j * comb(order, j) for j in range(order + 1)]) / comb(2 * order, order) ** 0.5
        return np.broadcast_to(row, rows.shape), rows
    at = time[rows]
    weights = np.ones_like(at)
    for j in range(order + 1):
        for other in range(order + 1):
            if other != j:
                weights[:, j] /= at[:, j] - at[:, other]
    return weights / np.sqrt((weights**2).sum(axis=1, keepdims=True)), rows


def _trimmed(differences: FloatArray) -> float:
    squares = np.sort(differences**2)
    return float(squares[: max(int(TRIM_QUANTILE * squares.size), 1)].mean() / TRIMMED_NORMAL_VARIANCE)


def _correlated_variance(lags: FloatArray | float, memory: float, order: int) -> FloatArray:
    """Compute the variance of differences of an Ornstein-Uhlenbeck process of variance one."""
    r = np.exp(-np.asarray(lags) / memory)
    whole = comb(2 * order, order)
    terms = [2.0 * (-1) ** j * comb(2 * order, order + j) / whole * r**j for j in range(1, order + 1)]
    return np.asarray(1.0 + sum(terms))


def _fit_noise_variances(
    lags: FloatArray, variances: FloatArray, order: int, windows: int, calm: bool
) -> NoiseVariances:
    """Fit non-negative least squares over the lags. Correlated noise must fit better than a drift."""
    # A window of p lags has about one independent difference, whose square has a relative deviation of sqrt(2).
    error = np.sqrt(2.0 * order * lags / windows / TRIM_QUANTILE + SHAPE_ERROR**2)
    over = lags / lags[-1]
    steady, smooth, drift, kinks = np.ones(lags.size), over ** (2 * order), over, over**3

    def fit(*columns: FloatArray) -> tuple[float, FloatArray]:
        scale = 1.0 / (error * variances)
        solution, misfit = scipy.optimize.nnls(np.column_stack(columns) * scale[:, None], variances * scale)
        return float(misfit**2), solution

    if calm and lags.size >= 5:
        best, memory, shares = np.inf, 0.0, np.zeros(3)
        for tried in np.geomspace(1.0, MAX_FITTED_TAU_SHARE * lags[-1], 20):
            misfit, solution = fit(steady, smooth, _correlated_variance(lags, tried, order))
            if misfit < best:
                best, memory, shares = misfit, float(tried), solution
        gain, ahead = fit(steady, smooth)[0] - best, fit(steady, smooth, drift)[0] - best
        white, slow = float(shares[0]), float(shares[2])
        if slow > 0.0 and gain >= MIN_CHI_SQUARED_GAIN and ahead > MIN_GAIN_OVER_DRIFT:
            near = white + slow * float(_correlated_variance(1.0, memory, order))
            return NoiseVariances(white, slow, memory, near, float(variances[0]), windows)
    white = float(fit(steady, smooth, drift, kinks)[1][0])
    return NoiseVariances(white, 0.0, 0.0, white, float(variances[0]), windows)
