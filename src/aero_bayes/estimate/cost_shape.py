"""What is known of a likelihood's shape: which coordinates are logarithms, and where delays cause kinks.

A delay that moves a jump of the input across a sample changes that reading at once, so that the likelihood has a kink
there. A gradient taken on one side of a kink says nothing about the other side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.step_rule import CostShape
from aero_bayes.simulation.interface import DelayTarget

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
