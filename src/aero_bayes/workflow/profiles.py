"""Profile likelihoods of the parameters that a Gaussian interval may misjudge."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from aero_bayes.check.likelihood_profile import LOG_POSTERIOR_DROP_90, profile_likelihood
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.levenberg_marquardt import LocalSettings
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.progress import ProgressBar
from aero_bayes.simulation import open_simulator
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.workflow.job import Job

Json = dict[str, Any]

#: Points of a profile, iterations of its search, and seconds after which no further one is begun.
PROFILE_POINTS, MAX_PROFILE_ITERATIONS, PROFILE_TIME_LIMIT = 15, 15, 4.0
#: Distance from a bound, in standard deviations, below which a parameter gets a profile.
MIN_BOUND_DEVIATIONS = 2.0


def _parameters_to_profile(found: Fit) -> list[str]:
    """List fitted physical parameters that are weak or not identified, or that lie at a bound; the weakest first."""
    low, high = found.calibration.parameters.box
    point = found.calibration.parameters.to_search(found.values)
    doubts = []
    for position, column in enumerate(found.free):
        item = found.calibration.parameters.items[column]
        room = min(point[column] - low[column], high[column] - point[column])
        identified = found.identifiability.status[item.name] is Status.IDENTIFIED
        unsure = not identified or room < MIN_BOUND_DEVIATIONS * found.laplace.sd[position]
        if isinstance(item.target, ParameterTarget) and unsure:
            doubts.append((-found.identifiability.ratio[item.name], item.name))
    return [name for _, name in sorted(doubts)]


def profile_part(job: Job, found: Fit, progress: ProgressBar) -> Json:
    """Return the ``profiles`` of result.json's ``identifiability``: nothing where no parameter is doubtful."""
    names = _parameters_to_profile(found)
    if not names:
        return {}
    began = time.perf_counter()
    profiles: Json = {}
    skipped: list[str] = []
    with (
        threadpool_limits(limits=1, user_api="blas"),
        open_simulator(found.calibration.problem(), job.engine, job.options.workers) as simulator,
    ):
        for k, name in enumerate(names):
            if profiles and (time.perf_counter() - began) * (k + 1) / k > PROFILE_TIME_LIMIT:
                skipped = names[k:]
                break
            progress("profiles", k / len(names), name)
            try:
                curve = profile_likelihood(
                    found, name, simulator, points=PROFILE_POINTS,
                    settings=LocalSettings(iterations=MAX_PROFILE_ITERATIONS, tolerance=1e-3),
                )  # fmt: skip
            except CannotFinishError:
                skipped.append(name)
                continue
            alone = ParameterSet((found.calibration.parameters[name],))
            prior = alone.log_prior(alone.to_search(curve.values[:, None]))
            profiles[name] = {
                "unit": curve.unit,
                "values": curve.values.tolist(),
                "drop": [d if np.isfinite(d) else None for d in curve.drop.tolist()],
                "prior_drop": (prior.max() - prior).tolist(),
                "interval": list(curve.interval),
                "bounded": curve.bounded,
            }
    return {
        "identifiability": {"profiles": profiles, "profile_drop_90": LOG_POSTERIOR_DROP_90, "not_profiled": skipped}
    }
