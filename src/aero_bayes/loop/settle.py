"""Decide, find what the decision hangs on, and decide again until nothing new is asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

from aero_bayes.errors import CannotFinishError
from aero_bayes.loop.decide import Decision, decide
from aero_bayes.search.models import FittedModel
from aero_bayes.search.search import Search
from aero_bayes.search.table import Terms

#: Decisions after which the last one stands.
MOST_DECISIONS = 40


def settled(search: Search, unseen: Callable[[FittedModel], dict[str, float]], late: Callable[[], bool]) -> Decision:
    """The decision on a search's table once all that it hangs on was fitted without each block, held against unseen
    recordings, and against what else may be in the place of each of its terms."""
    required = search.library.required
    for _ in range(MOST_DECISIONS):
        decision = decide(search.table, required)
        if _see(search, unseen, decision.compared_unseen):
            continue
        if late():
            return decision
        if new := [k for k in decision.compared if not search.table.rows[k].refitted]:
            search.refit(new)
            continue
        before = len(search.fits)
        todo = [k for k in _parts(search, decision) if k not in search.completed]
        if not todo:
            return decision
        for part in todo:
            search.complete(decision.model, part)
        if len(search.fits) == before and all(k in search.table.rows for k in todo):
            return decision
    return decision


def _see(search: Search, unseen: Callable[[FittedModel], dict[str, float]], structures: Sequence[Terms]) -> bool:
    """Predict the unseen recordings with structures that did not yet; whether there were any."""
    new = [k for k in structures if search.table.rows[k].unseen is None]
    for k in new:
        found: dict[str, float] = {}
        with suppress(CannotFinishError):
            found = unseen(search.fits[k])
        search.table.rows[k] = replace(search.table.rows[k], unseen=found)
    return bool(new)


def _parts(search: Search, decision: Decision) -> list[Terms]:
    """The model without each of its terms, in whose place all others are to be tried; and of a law beside a curve what
    it does without the curve."""
    model, curves = decision.model, set(search.library.curves)
    parts = [tuple(x for x in model if x != t) for t in decision.claims]
    laws = tuple(t for t in model if t not in curves)
    if laws != model:
        parts += [tuple(x for x in laws if x != t) for t in laws if t in decision.claims]
    return list(dict.fromkeys(parts))
