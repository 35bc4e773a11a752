"""The shape of a likelihood, as far as it is known: what is a logarithm, and where there are kinks.

A delay that carries a jump of the input across a reading changes that reading at once.
A slope that is taken beside a kink says nothing about the other side, so that a search whose step was refused there
stays on its own side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.way import Shape
from aero_bayes.simulation.interface import DelayTarget

FloatArray = NDArray[np.float64]

#: Share of a sample interval that is left free at both its ends: at the kink itself a slope is of either side.
ASIDE = 1e-6


def shape_of(parameters: ParameterSet, free: Sequence[int], intervals: Sequence[float]) -> Shape:
    """Which of the free coordinates are logarithms, and where a delay among them has kinks.

    ``intervals`` are the sample intervals of the recordings in s.
    """
    own = type(parameters)(tuple(parameters.items[j] for j in free))
    steps = {
        k: intervals[item.recording] if item.recording is not None else min(intervals)
        for k, item in enumerate(own.items)
        if isinstance(item.target, DelayTarget)
    }

    def walls(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = own.from_search(point)
        low, high = np.full(point.size, -np.inf), np.full(point.size, np.inf)
        for k, step in steps.items():
            first = np.floor(values[k] / step + ASIDE)
            for bound, at in ((low, first + ASIDE), (high, first + 1.0 - ASIDE)):
                values[k] = at * step
                bound[k] = own.to_search(values)[k]
        return low, high

    return Shape(walls if steps else None, own.logarithmic)
