"""Cross-validation of a fit: later blocks of each recording, and whole recordings from the others."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from aero_bayes.config import PredictionSection
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.result import Fit
from aero_bayes.progress import ProgressBar
from aero_bayes.simulation import open_simulator
from aero_bayes.workflow.job import Job

Json = dict[str, Any]

#: Posterior draws behind a recording's density, behind those of stretches, and stretches known before the first is
#: predicted, as a share of all.
DRAWS, STRETCH_DRAWS, INITIAL_SHARE = 10, 100, 0.5
#: Rows of all recordings up to which posteriors of the past are computed anew without being asked.
MAX_REFIT_ROWS = 10_000


def prediction_settings(job: Job) -> PredictionSection | None:
    """Return the settings with ``refits`` decided; None for a single recording, or if switched off."""
    section = job.config.prediction
    if len(job.recordings) < 2 or section.max_seconds == 0.0:
        return None
    short = sum(r.rows for r in job.recordings) <= MAX_REFIT_ROWS
    return section if section.refits is not None else section.model_copy(update={"refits": short})


def prediction_part(job: Job, found: Fit, progress: ProgressBar) -> Json:
    """Return the ``prediction`` entry of result.json; nothing for a single recording, or where it is switched off."""
    section = prediction_settings(job)
    if section is None:
        return {}
    # with the sampler, which takes a second to import
    from aero_bayes.check.crossvalidation import leave_one_recording_out, time_ordered_scores

    opener = partial(open_simulator, engine=job.engine, workers=job.options.workers)
    rng = np.random.default_rng([job.options.seed, 7])
    entry: Json = {}
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            left_out = leave_one_recording_out(
                found, opener, rng, draws=DRAWS, progress=progress, time_limit=section.max_seconds
            )
            entry["recordings"] = {one.recording: one.to_dict() for one in left_out}
            ordered = time_ordered_scores(
                found, opener, rng, blocks=section.stretches, first=max(1, round(INITIAL_SHARE * section.stretches)),
                draws=STRETCH_DRAWS, refits=bool(section.refits), progress=progress,
            )  # fmt: skip
            entry["stretches"] = ordered.to_dict()
    except CannotFinishError as error:
        entry["note"] = f"not completed: {error}"
    missing = [r.name for r in job.recordings if r.name not in entry.get("recordings", {})]
    if missing and "note" not in entry:
        entry["note"] = f"{', '.join(missing)} not predicted: the time limit of {section.max_seconds:g} s was reached"
    return {"prediction": entry}
