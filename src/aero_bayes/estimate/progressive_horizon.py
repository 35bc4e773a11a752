"""Fit the beginning of the recordings first, then ever longer horizons.

The likelihood of a long recording of an oscillating or unstable system has many local optima; that of its beginning has
few. Multiple shooting is another remedy (Voss, Timmer and Kurths, 2004, Int. J. Bifurcation and Chaos 14, 1905).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import Arrays
from aero_bayes.data import noise_floors
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.simulation.interface import Problem, Simulator

OpenSimulator = Callable[[Problem], AbstractContextManager[Simulator]]

#: Shares of the recordings that are fitted one after the other.
HORIZON_SHARES = (0.05, 0.075, 0.11, 0.17, 0.25, 0.38, 0.57, 0.8)
#: Residual over noise floor up to which no other optimum can be much better.
GOOD_FIT_RATIO = 1.2
#: From this share on, the residuals must be at most this many times those of a fit that is known already.
MIN_CHECKED_SHARE, MAX_RESIDUAL_RATIO = 0.17, 0.8


def fit_progressive_horizon(
    whole: Objective,
    start: FloatArray,
    free: Sequence[int],
    settings: LocalFitSettings,
    open_simulator: OpenSimulator,
    known: FloatArray | None = None,
) -> tuple[FloatArray, int]:
    """Fit ever longer horizons by least squares."""
    by_squares = settings.least_squares(whole.outputs)

    def fit_horizons() -> Arrays:
        point, steps = start, 0
        for share in HORIZON_SHARES:
            part = replace(whole.calibration, data=whole.calibration.data.beginning(share))
            with open_simulator(part.problem()) as simulator, suppress(CannotFinishError):
                objective = whole.with_calibration(part, simulator)
                found = local_fit(objective, point, free, settings=by_squares)
                point, steps = found.coordinates, steps + found.steps
                if share >= MIN_CHECKED_SHARE and known is not None:
                    (reference,) = objective.residuals(known[np.newaxis, :])
                    if (
                        reference is not None
                        and _residual_ratio(found.evaluation.residual, reference.residual) > MAX_RESIDUAL_RATIO
                    ):
                        break
        return {"point": point, "steps": np.array(steps)}

    key = (start, tuple(free), by_squares, known)
    end = whole.cached("progressive_horizon", key, fit_horizons)
    return end["point"].astype(np.float64), int(end["steps"])


def floor_ratio(objective: Objective, residual: Sequence[FloatArray]) -> float:
    """Return the largest ratio of an output's RMS residual to its noise floor.

    Infinite where a noise floor is unknown."""
    recordings, worst = objective.calibration.data.recordings, 0.0
    floors = noise_floors(recordings, objective.outputs)
    if any((r.name, o) not in floors for r in recordings for o in objective.outputs if o in r.outputs):
        return math.inf
    for (_, output), floor in floors.items():
        own = [r for s, r in zip(objective.series, residual, strict=True) if s.output == output]
        size = math.sqrt(float(np.mean(np.concatenate(own) ** 2)))
        worst = max(worst, size / floor if floor > 0.0 else math.inf)
    return worst


def _residual_ratio(these: Sequence[FloatArray], those: Sequence[FloatArray]) -> float:
    """Compute the geometric mean over all series of the ratio of their RMS residuals."""
    logs = [
        0.5 * math.log(max(float(one @ one), 1e-300) / max(float(other @ other), 1e-300))
        for one, other in zip(these, those, strict=True)
    ]
    return math.exp(sum(logs) / len(logs))
