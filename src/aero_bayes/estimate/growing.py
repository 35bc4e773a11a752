"""A climb that fits the beginning of the recordings first, then ever more of them.

A motion that turns over, or anything that forgets its past slowly, has a wide valley only while it is short.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress

import numpy as np
from numpy.typing import NDArray

from aero_bayes.checkpoint import Arrays
from aero_bayes.data import floors_of
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.simulation.interface import Problem, Simulator

FloatArray = NDArray[np.float64]
OpenSimulator = Callable[[Problem], AbstractContextManager[Simulator]]

#: Shares of the recordings that are fitted one after the other where the whole has many valleys.
HORIZONS = (0.05, 0.075, 0.11, 0.17, 0.25, 0.38, 0.57, 0.8)
#: From which share on the way must follow the recordings better than what is known already, and by which factor.
PROVEN, BETTER = 0.17, 0.8


def grown(
    whole: Objective,
    start: FloatArray,
    free: Sequence[int],
    settings: LocalFitSettings,
    open_simulator: OpenSimulator,
    known: FloatArray | None = None,
) -> tuple[FloatArray, int]:
    """Where a start leads if the beginning is fitted first, by least squares, and the steps that it took.

    ``known`` are coordinates of a fit of the whole: a way that does not follow the beginning better ends there.
    """
    by_squares = settings.least_squares(whole.outputs)

    def growing() -> Arrays:
        point, steps = start, 0
        for share in HORIZONS:
            part = whole.calibration.beginning(share)
            with open_simulator(part.problem()) as simulator, suppress(CannotFinishError):
                objective = whole.on(part, simulator)
                found = local_fit(objective, point, free, settings=by_squares)
                point, steps = found.coordinates, steps + found.steps
                if share >= PROVEN and known is not None:
                    (there,) = objective.residuals(known[np.newaxis, :])
                    if there is not None and _size(found.evaluation.residual, there) > BETTER:
                        break
        return {"point": point, "steps": np.array(steps)}

    asked = (start, tuple(free), by_squares, known)
    end = whole.once("grown", asked, growing)
    return end["point"].astype(np.float64), int(end["steps"])


def over_floor(objective: Objective, residual: Sequence[FloatArray]) -> float:
    """How many times the noise floor of the recordings the output that is followed worst is off.

    Infinite where a floor is unknown: nothing then says that a fit has come down to it.
    """
    recordings, worst = objective.calibration.recordings, 0.0
    floors = floors_of(recordings, objective.outputs)
    if any((r.name, o) not in floors for r in recordings for o in objective.outputs if o in r.outputs):
        return math.inf
    for (_, output), floor in floors.items():
        own = [r for s, r in zip(objective.series, residual, strict=True) if s.output == output]
        size = math.sqrt(float(np.mean(np.concatenate(own) ** 2)))
        worst = max(worst, size / floor if floor > 0.0 else math.inf)
    return worst


def _size(these: Sequence[FloatArray], those: Sequence[FloatArray]) -> float:
    """Residuals over others, each output in its own unit: the mean of the logarithms' difference, as a factor."""
    logs = [
        0.5 * math.log(max(float(one @ one), 1e-300) / max(float(other @ other), 1e-300))
        for one, other in zip(these, those, strict=True)
    ]
    return math.exp(sum(logs) / len(logs))
