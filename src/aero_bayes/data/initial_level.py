"""The initial value of a series of noisy readings, by local polynomial regression."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from aero_bayes.arrays import FloatArray

#: Numbers of first readings to which a polynomial is fitted.
WINDOW_LENGTHS = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
#: Largest degree of the polynomials. Each is compared with the next higher degree.
MAX_DEGREE = 2
#: Standard deviations by which the squared residual of a polynomial may exceed its expectation.
MAX_RESIDUAL_RATIO = 2.0


class InitialLevel(NamedTuple):
    """The initial value, and the standard deviation of its error."""

    level: float
    sd: float


def initial_level(values: FloatArray, time: FloatArray, floor: float) -> InitialLevel | None:
    """Estimate the value at ``time[0]`` by the constant, line or parabola with the least mean squared error."""
    seen = np.flatnonzero(np.isfinite(values))[: WINDOW_LENGTHS[-1]]
    if not seen.size:
        return None
    return _least_error(values[seen].tobytes(), (time[seen] - time[0]).tobytes(), floor)


@lru_cache(maxsize=256)  # each structure of a search starts at the same readings
def _least_error(values: bytes, times: bytes, floor: float) -> InitialLevel:
    y, t = np.frombuffer(values), np.frombuffer(times)
    best, error = float(y[0]), floor**2
    for n in WINDOW_LENGTHS:
        if n > y.size:
            break
        found = [_extrapolated(y[:n], t[:n], degree, floor) for degree in range(min(MAX_DEGREE + 2, n))]
        for (level, variance, fits), (further, doubt, _) in pairwise(found):
            # The change to the next degree estimates the bias, less the variance of that change.
            bias = max((further - level) ** 2 - (doubt - variance), 0.0)
            if fits and variance + bias < error:
                best, error = level, variance + bias
    return InitialLevel(best, math.sqrt(error))


def _extrapolated(y: FloatArray, t: FloatArray, degree: int, floor: float) -> tuple[float, float, bool]:
    """Compute the value at zero of a fitted polynomial, its variance, and whether its residual is within the noise."""
    basis = np.vander(t / (float(t[-1]) or 1.0), degree + 1, increasing=True)
    inverse = np.linalg.pinv(basis)
    left, free = y - basis @ (inverse @ y), y.size - degree - 1
    fits = float(left @ left) <= floor**2 * (free + MAX_RESIDUAL_RATIO * math.sqrt(2.0 * free))
    return float(inverse[0] @ y), floor**2 * float(inverse[0] @ inverse[0]), fits
