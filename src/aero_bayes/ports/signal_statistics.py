"""What signals of recordings are like: nominal value, range, how often it is passed, how fast they change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.simulation.interface import InputSignal

#: The nominal value of a signal is this quantile of its absolute values.
NOMINAL_QUANTILE = 0.995
#: Share of its range that a place must move in a direction for that to count.
MIN_TRAVEL_SHARE = 0.02
#: Share of its range by which a signal must move back to count as turning back: sensor noise is less.
MIN_RETURN_SHARE = 0.1
#: Parts of a signal's range that are looked at for how often it passes them.
RANGE_PARTS = 40
#: Least time scale in readings. Laws regard a small share of the time scale as short.
MIN_READINGS_PER_TIME = 10.0


def signal_nominal(parts: Sequence[FloatArray]) -> float:
    """Return the quantile :data:`NOMINAL_QUANTILE` of the absolute values of a signal; 0 without values."""
    return float(np.quantile(np.abs(np.concatenate(parts)), NOMINAL_QUANTILE)) if parts else 0.0


def visited_range(signal: str, parts: Sequence[FloatArray]) -> dict[str, float]:
    """Return the range of a signal but for rare extremes, by ``<signal>_low`` and ``<signal>_high``.

    Empty without values."""
    if not parts:
        return {}
    low, high = np.quantile(np.concatenate(parts), (1.0 - NOMINAL_QUANTILE, NOMINAL_QUANTILE))
    return {f"{signal}_low": float(low), f"{signal}_high": float(high)}


def share_visited_twice(parts: Sequence[FloatArray]) -> float:
    """Compute the share of a signal's range that it passes at least twice, over recordings (n,) one after the other.

    It counts as turning back where it moves back by :data:`MIN_RETURN_SHARE` of its range. Zero for what never moves.
    """
    whole = np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else np.zeros(0)
    span = float(np.ptp(whole)) if whole.size else 0.0
    if span <= 0.0:
        return 0.0
    turns = _turning_points(whole, MIN_RETURN_SHARE * span)
    grid = float(whole.min()) + span * (np.arange(RANGE_PARTS) + 0.5) / RANGE_PARTS
    low, high = np.minimum(turns[:-1], turns[1:]), np.maximum(turns[:-1], turns[1:])
    passes = ((low[:, np.newaxis] <= grid) & (grid <= high[:, np.newaxis])).sum(axis=0)
    return float(np.mean(passes >= 2))


def _turning_points(signal: FloatArray, least: float) -> FloatArray:
    """Find first value, extremes from which a signal (n,) moves back by more than ``least``, and the last extreme."""
    found, extreme, rising = [float(signal[0])], float(signal[0]), None
    for value in signal.tolist():
        if rising is None:
            rising = value > found[0] if abs(value - found[0]) > least else None
            extreme = value
        elif (value > extreme) is rising:
            extreme = value
        elif abs(value - extreme) > least:
            found.append(extreme)
            extreme, rising = value, not rising
    return np.array([*found, extreme])


def possible_directions(places: Sequence[FloatArray], speed: Mapping[str, float]) -> dict[str, float]:
    """Return the range of a speed, without a direction in which the place does not move.

    A place may be recorded where its speed is only simulated, by a fit that lacks an effect."""
    span = float(np.ptp(np.concatenate(places)))
    up = max(float(np.max(x - np.minimum.accumulate(x))) for x in places)
    down = max(float(np.max(np.maximum.accumulate(x) - x)) for x in places)
    found = dict(speed)
    if up < MIN_TRAVEL_SHARE * span:
        found["v_high"] = min(found["v_high"], 0.0)
    if down < MIN_TRAVEL_SHARE * span:
        found["v_low"] = max(found["v_low"], 0.0)
    return found


def relative_change(inputs: Sequence[InputSignal], time: float) -> float:
    """Compute the change of an input within ``time`` (s), over its nominal value.

    Changes that are at least as large make up half of the sum of all changes."""
    size = signal_nominal([s.values for s in inputs])
    moved = [np.abs(np.interp(s.time + time, s.time, s.values) - s.values) for s in inputs]
    steps = np.sort(np.concatenate(moved)) if moved else np.zeros(0)
    if size <= 0.0 or not steps.any():
        return 1.0
    return float(steps[np.searchsorted(np.cumsum(steps), 0.5 * steps.sum())]) / size


def fastest_time_scale(data: MeasuredData) -> float:
    """Estimate the time scale of the fastest output in s: its standard deviation over the RMS of its derivative."""
    times = []
    for experiment in data.experiments:
        for y in np.asarray(_smooth(experiment.measured)).T if experiment.measured is not None else ():
            seen = np.isfinite(y)
            if seen.sum() < 10:
                continue
            t, v = experiment.time[seen], y[seen]
            rate = float(np.sqrt(np.mean((np.diff(v) / np.diff(t)) ** 2)))
            step = float(np.median(np.diff(t)))
            if rate > 0.0:
                times.append(max(float(np.std(v)) / rate, MIN_READINGS_PER_TIME * step))
    return min(times, default=1.0)


def _smooth(measured: FloatArray, width: int = 5) -> FloatArray:
    """Compute moving averages, which suppress noise in the derivative."""
    kernel = np.ones(width) / width
    return np.stack([np.convolve(y, kernel, mode="same") for y in measured.T], axis=1)
