"""Whether the interval of each parameter, which takes the model as linear about the fit, holds at its ends."""

from __future__ import annotations

import numpy as np

from aero_bayes.estimate.laplace import Laplace
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.simulation.gaussian import NORMAL_HALF_WIDTH

#: How many times as far the log-likelihood may fall at an end as a linear model says, or as little, and the least fall
#: that is looked at: below it the prior makes the interval.
MAX_FACTOR, LEAST_FALL = 4.0, 0.3
NOT_RELIABLE = "interval not reliable: the model is not linear over it; sample the posterior"


def failed_intervals(objective: Objective, here: Optimum, laplace: Laplace) -> dict[str, str]:
    """Return what is wrong with linearised intervals, by parameter: one simulation at each end shows it.

    All other parameters are at their best there, as the linear model has it."""
    free, names = list(here.free), objective.parameters.names
    count = len(free)
    covariance = laplace.covariance[:count, :count]
    sd = np.sqrt(np.diag(covariance))
    if not count or not np.all(sd > 0.0):
        return {}
    steps = NORMAL_HALF_WIDTH * covariance / sd[:, None]
    rows = np.repeat(here.coordinates[None], 2 * count, axis=0)
    rows[:, free] += np.concatenate([steps, -steps])
    rows = np.clip(rows, *objective.parameters.box)
    moved = rows[:, free] - here.coordinates[free]
    score, information = here.whitened.score, here.whitened.information
    expected = 0.5 * np.sum((moved @ information) * moved, axis=1) - moved @ score
    failed: dict[str, str] = {}
    for k, found in enumerate(objective.residuals(rows)):
        if found is None or expected[k] < LEAST_FALL:
            continue
        fall = here.whitened.log_likelihood - objective.whiten(found, here.noise).log_likelihood
        if not expected[k] / MAX_FACTOR < fall < expected[k] * MAX_FACTOR:
            failed[names[free[k % count]]] = NOT_RELIABLE
    return failed
