"""Fit delays of the inputs, whose likelihood has a local optimum between every two samples.

A delay that moves a jump of the input across a sample changes that sample at once (a current follows within 0.14 ms).
So the log-posterior has kinks at multiples of the sample interval, and sometimes a peak beside one that is high but too
narrow to hold much probability. Local optima are therefore compared by their probability in Laplace's approximation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.cost_shape import cost_shape
from aero_bayes.estimate.levenberg_marquardt import LocalResult, LocalSettings, QuadraticModel, levenberg_marquardt
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.target import Target
from aero_bayes.simulation.interface import DelayTarget

#: Gain in log-probability at which another local optimum is preferred.
MIN_LOG_EVIDENCE_GAIN = 0.5
#: Where searches may start between two samples, as shares of the interval. A reading just after a jump catches the
#: current while it rises, so that the last percents of an interval can have a local optimum of their own.
START_SHARES = (0.15, 0.5, 0.85, 0.95, 0.98, 0.99, 0.996)
#: Sample intervals, the nearest to the present delay, that are searched.
MAX_INTERVALS = 60
#: Points of the grid in a first scan.
SCAN_POINTS = 41


def delay_columns(objective: Objective, free: Sequence[int]) -> list[int]:
    """Free columns that are delays."""
    return [j for j in free if isinstance(objective.parameters.items[j].target, DelayTarget)]


def better_delays(objective: Objective, here: Optimum, free: Sequence[int], *, prior: bool) -> FloatArray | None:
    """Search for a better local optimum of the delays than that of a fit."""
    if not delay_columns(objective, free):
        return None
    values = objective.parameters.from_search(here.coordinates)
    target = Target(objective.calibration, objective.simulator, values, free, prior=prior)
    point, moved = search_delays(target, here.coordinates[list(free)], objective.noise_rows(here.noise))
    objective.outcomes.update(target.outcomes)
    if not moved:
        return None
    coordinates = here.coordinates.copy()
    coordinates[list(free)] = point
    return coordinates


def scan_delays(objective: Objective, fit: Optimum, free: Sequence[int]) -> FloatArray:
    """Set each recording's delay to the best point of a grid; returns the coordinates (p,).

    A jump at the wrong time makes a few outliers. So differences of successive residuals are scored, with a
    heavy-tailed (Cauchy) loss, and not the slow misfit of a first fit."""
    parameters = objective.parameters
    columns = delay_columns(objective, free)
    if not columns:
        return fit.coordinates
    rows = np.repeat(fit.coordinates[np.newaxis, :], SCAN_POINTS, axis=0)
    for j in columns:
        rows[:, j] = np.linspace(parameters.box[0][j], parameters.box[1][j], SCAN_POINTS)
    costs = np.full((SCAN_POINTS, len(objective.calibration.data.experiments)), np.inf)
    for k, found in enumerate(objective.residuals(rows)):
        if found is None:
            continue
        costs[k] = 0.0
        for s, series in enumerate(objective.series):
            width = 2.0 * fit.noise[series.output].sd_white
            costs[k, series.experiment] += float(np.sum(np.log1p((np.diff(found.residual[s]) / width) ** 2)))
    best = fit.coordinates.copy()
    for j in columns:
        own = parameters.items[j].recording
        best[j] = rows[int(np.argmin(costs[:, own] if own is not None else costs.sum(axis=1))), j]
    return best


@dataclass(frozen=True)
class DelaySearchSettings:
    """Settings of the search over delays.

    For each delay, ``max_starts`` local searches start from the best points of a scan with the other parameters fixed.
    """

    max_starts: int = 6
    settings: LocalSettings = field(default_factory=lambda: LocalSettings(tolerance=1e-2, iterations=20))


def search_delays(
    target: Target, point: FloatArray, noise: FloatArray, search_settings: DelaySearchSettings | None = None
) -> tuple[FloatArray, bool]:
    """Search the likeliest local optima of each delay in turn, with all parameters free."""
    search_settings = search_settings or DelaySearchSettings()
    cost_function, (low, high) = target.cost_function(noise), target.box
    intervals = target.calibration.data.intervals
    shape = cost_shape(target.parameters, range(len(target.free)), intervals)
    moved = False
    for k, item in enumerate(target.parameters):
        starts = _starts(target, point, noise, k, item, intervals, search_settings.max_starts)
        found = [
            levenberg_marquardt(cost_function, start, low, high, search_settings.settings, shape=shape)
            for start in starts
        ]
        scores = [laplace_log_evidence(f) for f in found]
        best = int(np.argmax(scores)) if scores else 0
        if best > 0 and scores[best] > scores[0] + MIN_LOG_EVIDENCE_GAIN:
            point, moved = found[best].point, True
    return point, moved


def _starts(
    target: Target, point: FloatArray, noise: FloatArray, k: int, item: Parameter, intervals: Sequence[float], most: int
) -> list[FloatArray]:
    """List the point itself, then the best points of a scan over one delay; empty if there is nothing to scan."""
    if not isinstance(item.target, DelayTarget):
        return []
    width = item.upper - item.lower
    interval = intervals[item.recording] if item.recording is not None else min(intervals)
    offsets = np.add.outer(interval * np.arange(width / interval), interval * np.array(START_SHARES)).ravel()
    offsets = offsets[
        (offsets < width) & (np.abs(item.lower + offsets - point[k] * width) <= 0.5 * MAX_INTERVALS * interval)
    ]
    if offsets.size < 2:
        return []
    trial = np.tile(point, (offsets.size, 1))
    trial[:, k] = (item.lower + offsets) / width
    order = np.argsort(target.cost(trial, noise))[:most]
    return [point, *trial[order]]


def laplace_log_evidence(found: LocalResult[QuadraticModel]) -> float:
    """Compute the log-evidence of an optimum up to a constant, by Laplace's approximation.

    Minus infinity if it failed."""
    if found.quadratic is None:
        return -np.inf
    sign, determinant = np.linalg.slogdet(found.quadratic.hessian)
    return float(-found.cost - 0.5 * determinant) if sign > 0 else -np.inf
