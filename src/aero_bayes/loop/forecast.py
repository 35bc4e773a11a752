"""How long the search will take, from the first runs of the model; told before the time is spent."""

from __future__ import annotations

import time

from aero_bayes.loop.workbench import Workbench
from aero_bayes.search.models import FittedModel

#: Runs with derivatives that a search takes for each term: where one term explains what was missing (the cart of the
#: tutorial: 52), and where several are needed (three tanks: 200; a servo: 221).
EACH_TERM = 50, 200
#: Seconds from which on it is told.
LONG = 60.0


def tell_time(bench: Workbench, first: FittedModel, terms: int) -> None:
    """Say how long the search may take and how to shorten it, if that is longer than a minute."""
    began = time.perf_counter()
    first.model.objective.evaluate(first.optimum.coordinates, first.optimum.free)
    run = time.perf_counter() - began
    limit = bench.settings.max_minutes
    least, most = (min(n * terms * run / max(bench.pool.size, 1) / 60.0, limit) for n in EACH_TERM)
    if 60.0 * most < LONG:
        return
    span = f"{least:.1g} to {most:.2g}" if least < limit else f"{limit:g}"
    bench.progress(
        f"the search will take {span} min ({terms} terms, {1e3 * run:.2g} ms a run of the model); [loop] ports, laws "
        f"or exclude leave out terms, max_minutes = {limit:g} ends it before.",
        0.15,
    )
