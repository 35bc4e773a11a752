"""The noise floor of an output from its readings alone: no model, no fit.

Third differences over k samples, of weights (1, -3, 3, -1) / sqrt(20) on an even grid, take any local quadratic away
and keep the variance of white noise. How their variance grows with k tells noise from noise with memory and both from
the signal: constant for white noise, ``1 - 1.5 r + 0.6 r^2 - 0.1 r^3`` with r = exp(-k dt / tau) for an
Ornstein-Uhlenbeck process, k^6 for a smooth signal.

Limits, on simulated recordings of an AERO (see the tests): white noise within 3 % from 2,000 readings on, as long as
the signal is smooth over four samples most of the time. Noise with memory within 30 % where its correlation time is at
most 0.1 s for current and speed and 0.05 s for pitch; at 0.2 s it is found, but its size is off by up to a factor of
two, and slower or weaker memory (a tenth of the variance) looks like signal or white noise and is missed. A ripple is
not noise here: it is left out where the sample rate resolves it (see :mod:`aero_bayes.data.ripple`) and counts as white
where it does not. A quantised reading that stands still says nothing: the floor is then the quantum over sqrt(12).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from aero_bayes.data.recording import Recording

FloatArray = NDArray[np.float64]
LAGS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
#: Differences that are looked at for each lag; longer recordings are sampled evenly.
WINDOWS = 200_000
#: Share of the differences, by size, that counts; the largest are jumps of the signal.
KEPT = 0.8
#: How long ago, in s, a jump is over: the longest that leaves at least the share ``LEFT`` of the readings.
SETTLING = (1.0, 0.5, 0.3, 0.2, 0.1, 0.0)
LEFT = 0.2
#: Mean square of a standard normal variable below its 80 % quantile in absolute value.
_TRIMMED = 0.4377
#: How much better (in chi-squared) noise with memory must explain the differences before it is believed.
_GAIN = 12.0
#: Relative error that the signal's own share of the differences may leave.
_SLOPPY = 0.04


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of one output.

    Parameters
    ----------
    sd : float
        Standard deviation of all of it, never below ``quantum / sqrt(12)``.
    white, slow : float
        Its white part, and the part with memory.
    slow_time : float
        Correlation time of the slow part in s, 0 where there is none.
    correlation : float
        Correlation of the noise of neighbouring readings.
    quantum : float or None
        Step of the readings where they are quantised.
    readings : int
        How many there were.
    """

    sd: float
    white: float
    slow: float
    slow_time: float
    correlation: float
    quantum: float | None
    readings: int

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values."""
        return asdict(self)


def noise_floor(values: FloatArray, time: FloatArray, jumps: FloatArray | None = None) -> NoiseFloor:
    """Estimate the noise of readings.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Readings (or residuals), NaN in gaps.
    time : ndarray, shape (n,)
        Increasing times in s; they need not be even.
    jumps : ndarray, optional
        Times in s at which an input jumped. What follows each, for as long as enough is left elsewhere, is not used:
        the transients of current and speed are no noise. Give them where inputs jump more than a few times.

    Returns
    -------
    NoiseFloor
        All zero where fewer than 8 readings are left.
    """
    seen = np.isfinite(values)
    readings = int(seen.sum())
    quantum = quantisation_step(values)
    if readings < 8:
        return NoiseFloor(0.0, 0.0, 0.0, 0.0, 0.0, quantum, readings)
    interval = float(np.median(np.diff(time)))
    spread = difference_variances(values, time, jumps)
    white, slow, slow_time = _split(spread, interval, readings)
    total = np.sqrt(white**2 + slow**2)
    least = 0.0 if quantum is None else quantum / np.sqrt(12.0)
    if total < least:
        white, slow, slow_time, total = float(least), 0.0, 0.0, least
    shared = slow**2 * np.exp(-interval / slow_time) / total**2 if slow_time > 0.0 and total > 0.0 else 0.0
    return NoiseFloor(float(total), white, slow, slow_time, float(shared), quantum, readings)


def floors_of(recordings: Sequence[Recording], outputs: Sequence[str]) -> dict[tuple[str, str], float]:
    """Noise floor of every output of every recording, from its readings alone."""
    floors = {}
    for recording in recordings:
        jumps = np.concatenate(
            [recording.time[1:][np.diff(values) != 0.0] for values in recording.inputs.values()] or [np.empty(0)]
        )
        for output in outputs:
            if output in recording.outputs:
                floors[recording.name, output] = noise_floor(recording.outputs[output], recording.time, jumps).sd
    return floors


def difference_variances(values: FloatArray, time: FloatArray, jumps: FloatArray | None = None) -> dict[int, float]:
    """Variance of the normalised third differences by lag in samples, trimmed against jumps of the signal."""
    since = _since_jump(time, jumps)
    found: dict[int, float] = {}
    for lag in LAGS:
        if values.size < max(6 * lag, 8) or values.size - 3 * lag < 5:
            break
        windows = values.size - 3 * lag
        first = np.arange(windows) if windows <= WINDOWS else np.linspace(0, windows - 1, WINDOWS).astype(np.intp)
        index = first[:, None] + lag * np.arange(4)
        t = time[index]
        t = t - t[:, :1]
        weights = np.ones_like(t)
        for j in range(4):
            for other in range(4):
                if other != j:
                    weights[:, j] /= t[:, j] - t[:, other]
        differences = (weights * values[index]).sum(axis=1) / np.sqrt((weights**2).sum(axis=1))
        usable = np.isfinite(differences)
        # Undisturbed: the jump before the window's end also lies before its start, and long ago.
        calm = np.where(since[index[:, 3]] >= t[:, 3], since[index[:, 0]], -1.0)
        for settled in SETTLING:
            chosen = usable & (calm > settled)
            if chosen.sum() >= LEFT * usable.sum():
                usable = chosen
                break
        squares = np.sort(differences[usable] ** 2)
        if squares.size >= 5:
            kept = squares[: max(int(KEPT * squares.size), 1)]
            found[lag] = float(kept.mean() / _TRIMMED)
    return found


def _since_jump(time: FloatArray, jumps: FloatArray | None) -> FloatArray:
    """Time in s since the last jump, infinite before the first."""
    if jumps is None or jumps.size == 0:
        return np.full(time.size, np.inf)
    last = np.searchsorted(jumps, time, side="right") - 1
    return np.where(last >= 0, time - jumps[np.maximum(last, 0)], np.inf)


def quantisation_step(values: FloatArray) -> float | None:
    """Step of quantised readings, None where they are continuous.

    Robust against a print format that rounds: a step q counts if the distinct values lie within q / 10 of its
    multiples.
    Needs at least two distinct values, and five readings a value or one in five that is the one before.
    """
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
    # The first guess is only good for a few multiples; each pass reaches twice as far.
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


def _split(spread: dict[int, float], interval: float, readings: int) -> tuple[float, float, float]:
    """White and slow standard deviation and the slow part's correlation time, by least squares over the lags."""
    lags = np.array(list(spread), dtype=float)
    variances = np.array(list(spread.values()))
    usable = variances > 0.0
    if not usable.any():
        return 0.0, 0.0, 0.0
    lags, variances = lags[usable], variances[usable]
    # The signal takes over at some lag; beyond it there is nothing to learn about noise.
    near = variances < 30.0 * variances[0]
    lags, variances = lags[near], variances[near]
    # A window of 3 lags holds about one independent difference; their squares spread by sqrt(2).
    error = np.sqrt(2.0 * 3.0 * lags / readings / KEPT + _SLOPPY**2)
    flat = _fit(lags, variances, error, None)
    best, best_time = flat, 0.0
    if lags.size >= 5:
        for slow_lags in np.geomspace(1.0, float(lags[-1]), 24):
            tried = _fit(lags, variances, error, float(slow_lags))
            if tried[0] < best[0]:
                best, best_time = tried, float(slow_lags) * interval
        if flat[0] - best[0] < _GAIN or best[2] <= 0.0:
            best, best_time = flat, 0.0
    return float(np.sqrt(best[1])), float(np.sqrt(best[2])), best_time


def _fit(
    lags: FloatArray, variances: FloatArray, error: FloatArray, slow_lags: float | None
) -> tuple[float, float, float]:
    """(chi-squared, white, slow variance) for a correlation time in samples; the rest is signal."""
    columns = [np.ones(lags.size), (lags / lags[-1]) ** 6]
    if slow_lags is not None:
        r = np.exp(-lags / slow_lags)
        columns.append(1.0 - 1.5 * r + 0.6 * r**2 - 0.1 * r**3)
    scale = 1.0 / (error * variances)
    solution, misfit = nnls(np.column_stack(columns) * scale[:, None], variances * scale)
    return float(misfit**2), float(solution[0]), float(solution[2]) if slow_lags is not None else 0.0
