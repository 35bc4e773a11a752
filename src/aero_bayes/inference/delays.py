"""The valleys of a delay: a likelihood has one between every two samples, and a local search stays in its own.

A jump of the input that the delay moves across a sample changes that sample at once (a current follows within 0.14 ms),
so the log-posterior has kinks at multiples of the sample interval and sometimes a needle beside one, which is high but
holds hardly any probability. Valleys are therefore compared by the probability they hold, in Laplace's approximation.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from aero_bayes.inference.local import LocalResult, LocalSettings, search
from aero_bayes.inference.target import Target
from aero_bayes.simulation.interface import DelayTarget

FloatArray = NDArray[np.float64]

#: Gain in log-probability at which another valley is preferred.
LEAST_GAIN = 0.5
#: Where searches may start between two samples, as shares of the interval. A reading taken a moment after a jump sees
#: a current on its way, so that the last percents of an interval can hold a valley of their own.
SHARES = (0.15, 0.5, 0.85, 0.95, 0.98, 0.99, 0.996)


def best_valleys(
    target: Target,
    point: FloatArray,
    noise: FloatArray,
    intervals: Sequence[float],
    settings: LocalSettings | None = None,
    most: int = 6,
) -> tuple[FloatArray, bool]:
    """Search the likeliest valleys of every delay with all parameters free, one delay after the other.

    Parameters
    ----------
    target : Target
    point : ndarray, shape (f,)
        Search coordinates of the target's free parameters, at a local optimum.
    noise : ndarray
        Noise triples as a simulator takes them.
    intervals : sequence of float, length E
        Sample interval of each recording in s.
    settings : LocalSettings, optional
    most : int
        Valleys of one delay that are searched, the best of a scan with the other parameters held.

    Returns
    -------
    ndarray, shape (f,)
        The point in the best valleys found.
    bool
        Whether that is another one.
    """
    low, high = target.box
    moved = False
    for k, item in enumerate(target.parameters):
        if not isinstance(item.target, DelayTarget):
            continue
        width = item.upper - item.lower
        interval = intervals[item.recording] if item.recording is not None else min(intervals)
        offsets = np.add.outer(interval * np.arange(width / interval), interval * np.array(SHARES)).ravel()
        offsets = offsets[offsets < width]
        if offsets.size < 2:
            continue
        trial = np.tile(point, (offsets.size, 1))
        trial[:, k] = (item.lower + offsets) / width
        order = np.argsort(target.cost(trial, noise))[:most]
        starts = np.vstack([point, trial[order]])
        found = search(
            partial(target.products, noise=noise), starts, low, high, settings, partial(target.cost, noise=noise)
        )
        scores = log_mass(found)
        best = int(np.argmax(scores))
        if best > 0 and scores[best] > scores[0] + LEAST_GAIN:
            point, moved = found.points[best], True
    return point, moved


def log_mass(found: LocalResult) -> FloatArray:
    """Log-probability about the end of each search but for a constant, shape (k,); minus infinity where it failed."""
    scores = np.full(found.cost.shape, -np.inf)
    for k, (cost, hessian) in enumerate(zip(found.cost, found.hessian, strict=True)):
        sign, determinant = np.linalg.slogdet(hessian)
        if np.isfinite(cost) and sign > 0:
            scores[k] = -cost - 0.5 * determinant
    return scores
