"""Predict how long the search will take, from the first runs of the model."""

from __future__ import annotations

import time

from aero_bayes.loop.context import LoopContext
from aero_bayes.search.models import FittedModel

#: Runs with derivatives that a search takes for each term where several terms are needed (three tanks: 200; a servo:
#: 221). Where one explains what was missing it takes less (the cart of the tutorial: 52; an AERO: 8).
RUNS_PER_CANDIDATE = 200
#: Shortest duration that is announced, in s.
MIN_ANNOUNCED_SECONDS = 60.0


def announce_duration(context: LoopContext, first: FittedModel, terms: int) -> None:
    """Announce how long the search may take and how to shorten it, if it takes a minute or more."""
    run = min(_run(first) for _ in range(3))
    message = forecast_duration(run, terms, context.pool.size, context.settings.max_minutes)
    if message:
        context.progress(message, 0.15)


def forecast_duration(run: float, terms: int, workers: int, max_minutes: float) -> str:
    """Say how long a search may take; nothing where it takes less than :data:`MIN_ANNOUNCED_SECONDS`."""
    minutes = min(RUNS_PER_CANDIDATE * terms * run / max(workers, 1) / 60.0, max_minutes)
    if 60.0 * minutes < MIN_ANNOUNCED_SECONDS:
        return ""
    return (
        f"the search may take {minutes:.2g} min ({terms} candidates, {1e3 * run:.2g} ms per simulation). [loop] ports, "
        f"laws and exclude leave out candidates; max_minutes = {max_minutes:g} is the time limit."
    )


def _run(first: FittedModel) -> float:
    began = time.perf_counter()
    first.model.objective.evaluate(first.optimum.coordinates, first.optimum.free)
    return time.perf_counter() - began
