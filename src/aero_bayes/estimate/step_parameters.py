"""Parameters without a local slope: those that change nothing, and those that act in steps (they select a branch)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective

#: Nats by which the log-likelihood may differ for two values to count as equally good: it is noise of the solver.
EQUAL_LIKELIHOOD = 1e-2
#: Halvings of the range in which the end of a plateau is looked for: to less than a thousandth of the box.
BISECTIONS = 11
#: Number of values of a parameter without a slope that are tried, evenly over its box: it may act in steps.
TRIED_VALUES = 12
#: Effect of a parameter's whole range on the outputs, relative to the strongest, up to which it has no slope.
MIN_SENSITIVITY_RATIO = 1e-12


@dataclass(frozen=True)
class StepParameter:
    """A parameter that acts in steps: the fit is the same from ``lower`` to ``upper`` (SI units) and has no slope."""

    name: str
    lower: float
    upper: float

    @property
    def note(self) -> str:
        """What a reader should know."""
        return (
            f"acts in steps, so that the fit has no slope there: any value from {self.lower:.4g} to {self.upper:.4g} "
            "fits as well"
        )


def settle_blind(
    objective: Objective, here: Optimum, blind: Sequence[int]
) -> tuple[FloatArray, tuple[StepParameter, ...]]:
    """Put columns without a slope back to their start where the fit stays as good; the others keep what was found."""
    if not blind:
        return here.coordinates.copy(), ()
    parameters = objective.parameters
    start = parameters.to_search(parameters.start)
    point = here.coordinates.copy()
    point[list(blind)] = start[list(blind)]
    if _equal(objective, here, point):
        return point, ()
    point, steps = here.coordinates.copy(), []
    for j in blind:
        trial = point.copy()
        trial[j] = start[j]
        if _equal(objective, here, trial):
            point = trial
        else:
            steps.append(j)
    return point, tuple(_plateau(objective, here, point, j) for j in steps)


def with_slope(slopes: Sequence[FloatArray]) -> NDArray[np.bool_]:
    """Return which columns (k,) have a slope, by the slopes (k, n) of each series in search coordinates."""
    size = np.max([np.max(np.abs(rows), axis=1, initial=0.0) for rows in slopes], axis=0)
    return np.asarray(size > MIN_SENSITIVITY_RATIO * float(size.max(initial=0.0)))


def other_plateaus(objective: Objective, here: Optimum) -> list[FloatArray]:
    """List where to fit from to leave a plateau: search coordinates (p,), one for each other value of the cost.

    Empty where all free columns have a slope, or act in no steps."""
    slopes = here.evaluation.slopes
    if not slopes:
        return []
    blind = [j for j, own in zip(here.free, with_slope(slopes), strict=True) if not own]
    return [point for j in blind for point in _plateaus(objective, here.coordinates, j)[1:]]


def _plateaus(objective: Objective, point: FloatArray, column: int) -> list[FloatArray]:
    """Return the point, then one with another value of a column for each other sum of squares that its values give."""
    low, high = (bound[column] for bound in objective.parameters.box)
    trials = np.repeat(point[np.newaxis], 1 + TRIED_VALUES, axis=0)
    trials[1:, column] = low + (np.arange(TRIED_VALUES) + 0.5) / TRIED_VALUES * (high - low)
    distinct: dict[float, FloatArray] = {}
    for trial, found in zip(trials, objective.residuals(trials), strict=True):
        if found is not None:
            distinct.setdefault(sum(float(r @ r) for r in found.residual), trial)
    return list(distinct.values())


def _equal(objective: Objective, here: Optimum, point: FloatArray) -> bool:
    return objective.levels(point[None], here.noise)[0] >= here.whitened.log_likelihood - EQUAL_LIKELIHOOD


def _plateau(objective: Objective, here: Optimum, point: FloatArray, column: int) -> StepParameter:
    """Return the range about the value found in which the likelihood stays the same."""
    ends = []
    for bound in (side[column] for side in objective.parameters.box):
        inside, outside = point[column], float(bound)
        if _equal(objective, here, _moved(point, column, outside)):
            inside = outside
        for _ in range(BISECTIONS if inside != outside else 0):
            middle = 0.5 * (inside + outside)
            if _equal(objective, here, _moved(point, column, middle)):
                inside = middle
            else:
                outside = middle
        ends.append(float(objective.parameters.from_search(_moved(point, column, inside))[column]))
    return StepParameter(objective.parameters.names[column], ends[0], ends[1])


def _moved(point: FloatArray, column: int, coordinate: float) -> FloatArray:
    moved = point.copy()
    moved[column] = coordinate
    return moved
