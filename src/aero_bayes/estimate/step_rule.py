"""What is known of a likelihood's shape: which coordinates are logarithms, and where delays cause kinks.

A delay that moves a jump of the input across a sample changes that reading at once, so that the likelihood has a kink
there. A gradient taken on one side of a kink says nothing about the other side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.simulation.interface import DelayTarget

#: Distance from a kink, as a share of the smooth region, up to which a coordinate counts as at the kink.
KINK_TOLERANCE = 1e-3
#: Length of a Newton step in a logarithm above which steps linear in the logarithm and in the value differ noticeably.
MIN_LOG_STEP = 0.3
#: Ratio of actual to predicted decrease below which the next step is made in the other parametrisation.
MIN_GAIN_RATIO = 0.75

#: Bounds (p,) of the region about a point (p,) in which the cost is smooth.
SmoothRegion = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class CostShape:
    """What is known of a cost beforehand."""

    smooth_region: SmoothRegion | None = None
    logarithmic: NDArray[np.bool_] | None = None


class StepRule:
    """Make steps inside the box, on one side of a kink, linear in the coordinates or in their values."""

    def __init__(self, low: FloatArray, high: FloatArray, shape: CostShape) -> None:
        self.low, self.high, self.shape = low, high, shape
        self._logarithmic = shape.logarithmic if shape.logarithmic is not None else np.zeros(low.size, dtype=bool)
        self._confined = self._linear_in_values = self._switched = False

    def _region(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.shape.smooth_region(point) if self.shape.smooth_region is not None else (self.low, self.high)

    @property
    def _relative(self) -> NDArray[np.bool_]:
        """Coordinates whose steps are relative changes of their values."""
        return self._logarithmic & self._linear_in_values

    def bounds(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (p,) of a step from a point."""
        low, high = self.low - point, self.high - point
        if self._confined:
            region = self._region(point)
            low, high = np.maximum(low, region[0] - point), np.minimum(high, region[1] - point)
        relative = self._relative
        low[relative], high[relative] = np.expm1(low[relative]), np.expm1(high[relative])
        return low, high

    def apply(self, point: FloatArray, step: FloatArray) -> FloatArray:
        """Return the point (p,) after a step."""
        relative, moved = self._relative, point + step
        moved[relative] = point[relative] + np.log1p(step[relative])
        return np.clip(moved, self.low, self.high)

    def change_after_rejection(self, point: FloatArray, rejected: FloatArray, newton: FloatArray) -> bool:
        """Change the rule after a step to ``rejected`` failed; False if there is nothing left to change."""
        low, high = self._region(point)
        if not self._confined and np.any((rejected < low) | (rejected > high)):
            self._confined = True
            return True
        if self._switched or not self._is_long(newton):
            return False
        self._linear_in_values, self._switched = not self._linear_in_values, True
        return True

    def change_after_step(self, point: FloatArray, new: FloatArray, newton: FloatArray, gain_ratio: float) -> None:
        """Adapt the rule to a step to ``new`` that was taken; ``gain_ratio`` is its actual over predicted decrease."""
        self._switched = False
        self._confined = self._confined and self._stays_at_kink(point, new)
        if gain_ratio < MIN_GAIN_RATIO and self._is_long(newton):
            self._linear_in_values = not self._linear_in_values

    def _is_long(self, newton: FloatArray) -> bool:
        """Return whether the Newton step is so long that the two parametrisations differ."""
        return bool(np.any(np.abs(newton[self._logarithmic]) > MIN_LOG_STEP))

    def _stays_at_kink(self, point: FloatArray, new: FloatArray) -> bool:
        """Return whether a step moved along a kink."""
        low, high = self._region(point)
        kinked = np.isfinite(low)
        x, low, high = new[kinked], low[kinked], high[kinked]
        tolerance = KINK_TOLERANCE * (high - low)
        at_kink = (x <= low + tolerance) | (x >= high - tolerance)
        return bool(np.any(at_kink & (np.abs(x - point[kinked]) <= tolerance)))


#: Margin at both ends of a sample interval, as a share of it: at the kink itself a derivative may be of either side.
KINK_MARGIN = 1e-6


def cost_shape(parameters: ParameterSet, free: Sequence[int], intervals: Sequence[float]) -> CostShape:
    """Tell which of the free coordinates are logarithms, and where a delay among them has kinks.

    ``intervals`` are the sample intervals of the recordings in s."""
    own = type(parameters)(tuple(parameters.items[j] for j in free))
    steps = {
        k: intervals[item.recording] if item.recording is not None else min(intervals)
        for k, item in enumerate(own.items)
        if isinstance(item.target, DelayTarget)
    }

    def smooth_region(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = own.from_search(point)
        low, high = np.full(point.size, -np.inf), np.full(point.size, np.inf)
        for k, step in steps.items():
            first = np.floor(values[k] / step + KINK_MARGIN)
            for bound, at in ((low, first + KINK_MARGIN), (high, first + 1.0 - KINK_MARGIN)):
                values[k] = at * step
                bound[k] = own.to_search(values)[k]
        return low, high

    return CostShape(smooth_region if steps else None, own.logarithmic)
