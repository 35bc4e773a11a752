"""Where a series of readings begins: as surely as its noise lets one say."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: How many of the first readings are looked at together.
WINDOW_LENGTHS = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
#: Polynomials of up to this degree are tried, and each is held against the next.
MAX_DEGREE = 2
#: Standard deviations by which what a curve leaves may exceed the noise.
MAX_RESIDUAL_RATIO = 2.0


class InitialLevel(NamedTuple):
    """Where readings begin, and the standard deviation of its error."""

    level: float
    sd: float


def initial_level(values: FloatArray, time: FloatArray, floor: float) -> InitialLevel | None:
    """Value at ``time[0]`` of the constant, line or parabola through first readings that seems nearest to it.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Readings, NaN in gaps.
    time : ndarray, shape (n,)
        In s.
    floor : float
        Standard deviation of their noise: a curve that leaves more than that is none; without noise the first reading
        is what there is.

    Returns
    -------
    Beginning or None
        None where there is no reading.
    """
    seen = np.flatnonzero(np.isfinite(values))[: WINDOW_LENGTHS[-1]]
    if not seen.size:
        return None
    y, t = values[seen], time[seen] - time[0]
    best, error = float(y[0]), floor**2
    for n in WINDOW_LENGTHS:
        if n > seen.size:
            break
        found = [_extrapolated(y[:n], t[:n], degree, floor) for degree in range(min(MAX_DEGREE + 2, n))]
        for (level, variance, fits), (further, doubt, _) in pairwise(found):
            # What the next degree would change is bias, but for what its own noise makes of it.
            bias = max((further - level) ** 2 - (doubt - variance), 0.0)
            if fits and variance + bias < error:
                best, error = level, variance + bias
    return InitialLevel(best, math.sqrt(error))


def _extrapolated(y: FloatArray, t: FloatArray, degree: int, floor: float) -> tuple[float, float, bool]:
    """Value at zero of a polynomial through readings, its variance, and whether it leaves no more than the noise."""
    basis = np.vander(t / (float(t[-1]) or 1.0), degree + 1, increasing=True)
    inverse = np.linalg.pinv(basis)
    left, free = y - basis @ (inverse @ y), y.size - degree - 1
    fits = float(left @ left) <= floor**2 * (free + MAX_RESIDUAL_RATIO * math.sqrt(2.0 * free))
    return float(inverse[0] @ y), floor**2 * float(inverse[0] @ inverse[0]), fits
