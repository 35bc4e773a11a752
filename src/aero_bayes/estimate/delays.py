"""The input's delay: a likelihood has a valley between every two samples, and a local search stays in its own.

A jump of the input that the delay moves across a sample changes that sample at once (a current follows within 0.14 ms),
so the log-posterior has kinks at multiples of the sample interval and sometimes a needle beside one, which is high but
holds hardly any probability. Valleys are therefore compared by the probability they hold, in Laplace's approximation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.cost_shape import cost_shape
from aero_bayes.estimate.levenberg_marquardt import LocalSettings, QuadraticModel, SearchResult, levenberg_marquardt
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.target import Target
from aero_bayes.simulation.interface import DelayTarget

FloatArray = NDArray[np.float64]

#: Gain in log-probability at which another valley is preferred.
LEAST_GAIN = 0.5
#: Where searches may start between two samples, as shares of the interval. A reading taken a moment after a jump sees
#: a current on its way, so that the last percents of an interval can hold a valley of their own.
SHARES = (0.15, 0.5, 0.85, 0.95, 0.98, 0.99, 0.996)
#: Intervals, the nearest to the delay as it is, in which valleys are looked for.
NEAREST = 60
#: Points of a first scan.
POINTS = 41


def delay_columns(objective: Objective, free: Sequence[int]) -> list[int]:
    """Free columns that are delays."""
    return [j for j in free if isinstance(objective.parameters.items[j].target, DelayTarget)]


def scan_delays(objective: Objective, fit: Optimum, free: Sequence[int]) -> FloatArray:
    """Coordinates with each recording's delay at the best of a grid, (p,).

    A jump that is missed is a few wild readings: those are weighed, not the slow misfit of a first fit.
    """
    parameters = objective.parameters
    columns = delay_columns(objective, free)
    if not columns:
        return fit.coordinates
    rows = np.repeat(fit.coordinates[np.newaxis, :], POINTS, axis=0)
    for j in columns:
        rows[:, j] = np.linspace(parameters.box[0][j], parameters.box[1][j], POINTS)
    costs = np.full((POINTS, len(objective.calibration.experiments)), np.inf)
    for k, residual in enumerate(objective.residuals(rows)):
        if residual is None:
            continue
        costs[k] = 0.0
        for s, series in enumerate(objective.series):
            width = 2.0 * fit.noise[series.output].sd_white
            costs[k, series.experiment] += float(np.sum(np.log1p((np.diff(residual[s]) / width) ** 2)))
    best = fit.coordinates.copy()
    for j in columns:
        own = parameters.items[j].recording
        best[j] = rows[int(np.argmin(costs[:, own] if own is not None else costs.sum(axis=1))), j]
    return best


@dataclass(frozen=True)
class Valleys:
    """How valleys are searched: ``most`` of one delay, the best of a scan with the other parameters held."""

    most: int = 6
    settings: LocalSettings = field(default_factory=lambda: LocalSettings(tolerance=1e-2, max_iterations=20))


def best_valleys(
    target: Target, point: FloatArray, noise: FloatArray, valleys: Valleys | None = None
) -> tuple[FloatArray, bool]:
    """Search the likeliest valleys of every delay with all parameters free, one delay after the other.

    Parameters
    ----------
    target : Target
    point : ndarray, shape (f,)
        Search coordinates of the target's free parameters, at a local optimum.
    noise : ndarray
        Noise triples as a simulator takes them.
    valleys : Valleys, optional

    Returns
    -------
    ndarray, shape (f,)
        The point in the best valleys found.
    bool
        Whether that is another one.
    """
    valleys = valleys or Valleys()
    cost_function, (low, high) = target.at(noise), target.box
    intervals = target.calibration.intervals
    shape = cost_shape(target.parameters, range(len(target.free)), intervals)
    moved = False
    for k, item in enumerate(target.parameters):
        starts = _starts(target, point, noise, k, item, intervals, valleys.most)
        found = [
            levenberg_marquardt(cost_function, start, low, high, valleys.settings, shape=shape) for start in starts
        ]
        scores = [log_mass(f) for f in found]
        best = int(np.argmax(scores)) if scores else 0
        if best > 0 and scores[best] > scores[0] + LEAST_GAIN:
            point, moved = found[best].point, True
    return point, moved


def _starts(
    target: Target, point: FloatArray, noise: FloatArray, k: int, item: Parameter, intervals: Sequence[float], most: int
) -> list[FloatArray]:
    """The point itself, then the best of the valleys of one delay; empty for what is no delay, or has no valleys."""
    if not isinstance(item.target, DelayTarget):
        return []
    width = item.upper - item.lower
    interval = intervals[item.recording] if item.recording is not None else min(intervals)
    offsets = np.add.outer(interval * np.arange(width / interval), interval * np.array(SHARES)).ravel()
    offsets = offsets[(offsets < width) & (np.abs(offsets - point[k] * width) <= 0.5 * NEAREST * interval)]
    if offsets.size < 2:
        return []
    trial = np.tile(point, (offsets.size, 1))
    trial[:, k] = (item.lower + offsets) / width
    order = np.argsort(target.cost(trial, noise))[:most]
    return [point, *trial[order]]


def log_mass(found: SearchResult[QuadraticModel]) -> float:
    """Log-probability about the end of a search but for a constant; minus infinity where it failed."""
    if found.quadratic is None:
        return -np.inf
    sign, determinant = np.linalg.slogdet(found.quadratic.hessian)
    return float(-found.cost - 0.5 * determinant) if sign > 0 else -np.inf
