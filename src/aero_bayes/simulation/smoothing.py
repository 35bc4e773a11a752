"""States given all readings, from what a filter knew before each of them.

The modified Bryson-Frazier form of the Rauch-Tung-Striebel smoother (Bierman, 1973, International Journal of Control
18, 65): no covariance is inverted, so that states without any uncertainty are no exception.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.simulation.gaussian import NORMAL_HALF_WIDTH
from aero_bayes.simulation.interface import FilteredStates


@dataclass(frozen=True, eq=False)
class SmoothedStates:
    """Mean and standard deviation (n, s) of the s states at each sample, given all readings of the recording."""

    mean: FloatArray
    sd: FloatArray

    @property
    def band(self) -> tuple[FloatArray, FloatArray]:
        """Ends (n, s) of the central intervals of 90 %."""
        return self.mean - NORMAL_HALF_WIDTH * self.sd, self.mean + NORMAL_HALF_WIDTH * self.sd

    def at(self, time: FloatArray, samples: FloatArray) -> SmoothedStates:
        """Return the states at times (k,) in s, along straight lines between the ``samples`` (n,).

        NaN outside of them."""
        mean, sd = (
            np.column_stack([np.interp(time, samples, row, np.nan, np.nan) for row in rows.T])
            for rows in (self.mean, self.sd)
        )
        return SmoothedStates(mean, sd)


def smooth(filtered: FilteredStates, measured: FloatArray) -> SmoothedStates:
    """Smooth a filter's states."""
    n, s = filtered.mean.shape
    mean, sd = np.empty((n, s)), np.empty((n, s))
    adjoint, information = np.zeros(s), np.zeros((s, s))
    for k in range(n - 1, -1, -1):
        covariance = filtered.covariance[k]
        for h, gain, away, variance in reversed(reading_updates(filtered, measured, k)):
            keep = np.eye(s) - np.outer(gain, h)
            adjoint = keep.T @ adjoint - h * (away / variance)
            information = keep.T @ information @ keep + np.outer(h, h) / variance
        mean[k] = filtered.mean[k] - covariance @ adjoint
        sd[k] = np.sqrt(np.maximum(np.diag(covariance - covariance @ information @ covariance), 0.0))
        step = filtered.transition[k]
        adjoint, information = step.T @ adjoint, step.T @ information @ step
    return SmoothedStates(mean, sd)


def reading_updates(
    filtered: FilteredStates, measured: FloatArray, k: int
) -> list[tuple[FloatArray, FloatArray, float, float]]:
    """Slope, gain, innovation and its variance of each reading of a sample, in the order in which they were taken."""
    covariance, found = filtered.covariance[k], []
    for o in np.flatnonzero(np.isfinite(measured[k])):
        h, variance = filtered.slopes[k, o], float(filtered.variance[k, o])
        gain = covariance @ h / variance
        covariance = covariance - np.outer(gain, gain) * variance
        found.append((h, gain, float(measured[k, o] - filtered.predicted[k, o]), variance))
    return found
