"""Very long recordings: structures are searched for on their beginnings, the final model is fitted to all readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.loop.base_fit import BaseFit, fit_base_model
from aero_bayes.loop.context import LoopContext
from aero_bayes.search.informative_part import tells_enough

#: Rows of a beginning: with so many a search takes a minute, and a recording that is no more than twice as long is
#: looked at whole. A beginning that tells less of a parameter, or of what is missing, than the rest is doubled.
FIRST_ROWS = 25_000


def on_beginnings(context: LoopContext, base: BaseFit, begin: Mapping[str, float]) -> tuple[LoopContext, BaseFit]:
    """Return the loop on the beginnings of its recordings, as if no more had been recorded.

    The loop itself where no recording is long, or no beginning tells as much per reading as the whole. A short
    recording beside long ones stays whole."""
    fitted = context.recordings.fitted
    lengths = [r.rows for r in fitted]
    if max(lengths) <= 2 * FIRST_ROWS:
        return context, base
    with context.open(base.plain.problem()) as simulator:
        rows = rows_that_tell_enough(context.objective(base.plain, simulator), base.fit, lengths)
    if max(lengths) <= 2 * rows:
        return context, base
    cut = tuple(r.rows_where(np.arange(r.rows) < rows, r.name) for r in fitted)
    part = replace(context, recordings=replace(context.recordings, train=cut, test=(), fitted=cut, unseen_from={}))
    return part, replace(fit_base_model(part, begin), diagnosis=base.diagnosis)


def rows_that_tell_enough(objective: Objective, fit: Optimum, lengths: Sequence[int]) -> int:
    """Return how many rows of each recording tell enough of the free parameters and of what is missing."""
    rows = FIRST_ROWS
    while rows < max(lengths):
        shares = [min(1.0, rows / own) for own in lengths]
        if tells_enough(objective, fit.evaluation, fit.noise, shares):
            break
        rows *= 2
    return rows
