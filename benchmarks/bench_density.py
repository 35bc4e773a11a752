"""The posterior that every sampler of the benchmarks is given."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from aero_bayes.estimate import Fit
from aero_bayes.estimate.target import Target


def density(fit: Fit, target: Target) -> Callable[[np.ndarray], np.ndarray]:
    """Make the log-posterior of the eight parameters with the noise held."""
    noise = target.objective.noise_rows(fit.noise)

    def value(points: np.ndarray) -> np.ndarray:
        total = np.full(len(points), -np.inf)
        inside = np.isfinite(target.parameters.log_prior(points))
        if inside.any():
            total[inside] = -target.cost(points[inside], noise)
        return total

    return value
