"""The noise floor of an output, estimated from its readings without a model.

The variance of differences of readings separates white noise, whose variance does not depend on the lag, from signals,
whose variance grows with the lag. The floor is known if

- by this growth, at least half of the variance of neighbouring readings is noise,
- differences of two successive orders (third and fourth, else fourth and fifth) agree, which they do not for a
  vibration, or a signal that is not smooth between two samples,
- and the inputs do not predict the differences: an output that follows an input which changes at every sample looks
  white.

Otherwise the floor is unknown, and the differences give only an upper bound. Feedback of the readings to an input also
makes inputs predict the differences, so that the floor is unknown. A signal that is as fast as the sampling, and whose
cause was not recorded, cannot be separated from noise.

Correlated noise is accepted where the inputs are constant, and only if the variance stops growing before the signal
dominates. For a correlation time of 3 to 10 samples and a signal with a time scale of a hundred samples, the estimate
is right within 30 %. Slower or weaker correlation looks like a drift or a signal and is missed. The floor is then the
white part. Ripple is no noise: it is excluded if the sample rate resolves it, and counts as white
otherwise. Constant quantised readings have no information. The floor is then the step over sqrt(12).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import comb

import numpy as np
import scipy  # imports its parts when they are first used
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording

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


#: Orders of differences. The estimates of two successive orders must agree.
DIFFERENCE_ORDERS = (3, 4, 5)
#: Smallest share of the differences' variance that is noise, and largest share that the inputs explain.
MIN_NOISE_SHARE, MAX_EXPLAINED_SHARE = 0.5, 0.25
#: Largest difference of the logarithms of the standard deviations of two orders.
MAX_LOG_DISAGREEMENT = 0.1
#: Smallest number of differences: with fewer the standard deviation is uncertain by more than a quarter.
MIN_DIFFERENCES = 36


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of one output: its standard deviation (None if unknown) and a bound, the step of quantised readings.

    ``slow`` is the part that is correlated over ``slow_time`` s, ``white`` the rest."""

    sd: float | None
    at_most: float
    quantum: float | None
    white: float = 0.0
    slow: float = 0.0
    slow_time: float = 0.0


def noise_floor(values: FloatArray, time: FloatArray, inputs: Sequence[FloatArray] = ()) -> NoiseFloor:
    """Estimate the noise of readings."""
    columns = (np.ascontiguousarray(column, dtype=np.float64).tobytes() for column in (values, time, *inputs))
    return _noise_floor(*columns)


@lru_cache(maxsize=64)  # each structure of a search is predicted on the same recordings
def _noise_floor(*columns: bytes) -> NoiseFloor:
    values, time, *inputs = map(np.frombuffer, columns)
    quantum = quantisation_step(values)
    least = 0.0 if quantum is None else quantum / math.sqrt(12.0)
    found, most = _noise(Differences(values, time, inputs))
    if found is None and most > least:
        return NoiseFloor(None, most, quantum)
    total = math.sqrt(found.white + found.slow) if found is not None else least
    if found is None or total <= least or found.slow == 0.0:
        total = max(total, least)
        return NoiseFloor(total, total, quantum, total)
    memory = found.memory * float(np.median(np.diff(time)))
    return NoiseFloor(total, total, quantum, math.sqrt(found.white), math.sqrt(found.slow), memory)


def _noise(differences: Differences) -> tuple[NoiseVariances | None, float]:
    """Return the noise if it is known, and an upper bound of its standard deviation."""
    lower: NoiseVariances | None = None
    most = math.inf
    for order in DIFFERENCE_ORDERS:
        found = differences.noise_variances(order)
        if found is None:
            break
        most = min(math.sqrt(found.whole), most)
        if found.whole == 0.0:
            return found, most
        if lower is not None and _agree(lower, found):
            return (lower if differences.explained(order - 1) <= MAX_EXPLAINED_SHARE else None), most
        lower = found
    if lower is None:
        most = float(np.nanstd(differences.values)) if np.isfinite(differences.values).any() else 0.0
    return None, most


def _agree(one: NoiseVariances, other: NoiseVariances) -> bool:
    """Return whether differences of two orders are mostly noise, and agree."""
    if (
        min(one.windows, other.windows) < MIN_DIFFERENCES
        or min(one.near / one.whole, other.near / other.whole) < MIN_NOISE_SHARE
    ):
        return False
    return abs(0.5 * math.log(one.near / other.near)) < MAX_LOG_DISAGREEMENT + 1.0 / math.sqrt(one.windows)


def output_noise_floor(recording: Recording, output: str) -> NoiseFloor:
    """Estimate the noise floor of an output of a recording, from its readings and the inputs."""
    return noise_floor(recording.outputs[output], recording.time, list(recording.inputs.values()))


def noise_floors(recordings: Sequence[Recording], outputs: Sequence[str]) -> dict[tuple[str, str], float]:
    """Estimate noise floors by recording and output. There is no entry for an unknown one."""
    floors = {}
    for recording in recordings:
        for output in outputs:
            if output in recording.outputs and (sd := output_noise_floor(recording, output).sd) is not None:
                floors[recording.name, output] = sd
    return floors


def quantisation_step(values: FloatArray) -> float | None:
    """Step of quantised readings, None where they are continuous.

    A step q is accepted if the distinct values are within q / 10 of its multiples, so that a rounding print format does
    not matter."""
    seen = values[np.isfinite(values)]
    if seen.size < 10:
        return None
    distinct = np.unique(seen)
    scale = float(np.abs(distinct).max()) or 1.0
    distinct = distinct[np.concatenate(([True], np.diff(distinct) > 1e-9 * scale))]
    still = float(np.mean(np.diff(seen) == 0.0)) > 0.2
    if distinct.size < 2 or not (still or distinct.size <= seen.size / 5):
        return None
    gaps = np.diff(distinct)
    step = float(np.quantile(gaps, 0.1))
    step = float(np.median(gaps[gaps < 1.5 * step]))
    raised = distinct - distinct[0]
    # The first estimate is accurate for a few multiples only; each pass covers twice as many.
    for reach in 2 ** np.arange(2, 64):
        part = raised[: min(int(reach), raised.size)]
        counts = np.rint(part / step)
        if counts[-1] < 1:
            return None
        step = float((part @ counts) / (counts @ counts))
        if reach >= raised.size:
            break
    off = np.abs(raised / step - np.rint(raised / step))
    return step if float(np.quantile(off, 0.95)) < 0.1 else None
