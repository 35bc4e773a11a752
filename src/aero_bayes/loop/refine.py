"""A finer law for an effect that was found: it takes the simple one's place where the data ask for its parameters.

The finer law has the simple one as a limit, so that it always fits at least as well; searched for beside the simple
one it would win or lose by chance. It is tried only after the search, and has to gain as much as a discovery; where it
gains less than that, the two are equivalent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.climb import climb
from aero_bayes.loop.attribute import Search
from aero_bayes.loop.prospect import Scored
from aero_bayes.loop.rounds import Round, Selection, threshold, with_odds
from aero_bayes.loop.stand import Held

#: Refits of a finer law, from the likeliest of its starts.
STARTS = 2


def refine(search: Search, selection: Selection, finer: Mapping[str, str], count: int) -> Selection:
    """The selection with each of its effects in the finest law that earns its place.

    Parameters
    ----------
    search : Search
    selection : Selection
    finer : mapping of str to str
        For each finer law the effect whose place it may take.
    count : int
        How many candidates there were.
    """
    bar = threshold(count, search.settings)
    for id_, coarse in finer.items():
        if coarse not in selection.effects or coarse in search.settings.require or id_ in selection.effects:
            continue
        found = _in_place_of(search, selection.held, coarse, id_)
        if found is None:
            continue
        gain = found.log_evidence - selection.held.log_evidence
        if not found.shows_shape(id_):
            # The evidence is that of a detail, not of the law.
            gain = min(gain, 0.0)
        if gain < bar:
            if gain > 0.0:
                selection = replace(selection, equivalent=_with(selection.equivalent, coarse, id_))
            continue
        scores, nothing, untried = with_odds([Scored(found.stand.candidates[id_], found, gain, gain)])
        why = f"{id_} in place of {coarse} gains {gain:.1f} in log-evidence (needed {bar:.1f})"
        number = len(selection.rounds) + 1
        last = Round(number, selection.held, scores, bar, scores[0], (id_,), why, nothing, untried)
        selection = replace(selection, held=found, rounds=(*selection.rounds, last))
        selection = _dropped(search, selection, id_, bar)
    return selection


def _with(classes: tuple[tuple[str, ...], ...], member: str, other: str) -> tuple[tuple[str, ...], ...]:
    """Classes of equivalent effects with ``other`` beside ``member``."""
    if any(member in ids for ids in classes):
        return tuple((*ids, other) if member in ids else ids for ids in classes)
    return (*classes, (member, other))


def _dropped(search: Search, selection: Selection, kept: str, bar: float) -> Selection:
    """The selection without effects that only made up for what the finer law now tells."""
    for other in [e for e in selection.effects if e != kept and e not in search.settings.require]:
        without = search.without(selection.base, selection.held, other)
        if without is not None and selection.held.log_evidence - without.log_evidence < bar:
            same = tuple(ids for ids in selection.equivalent if other not in ids)
            selection = replace(selection, held=without, equivalent=same)
    return selection


def _in_place_of(search: Search, held: Held, coarse: str, finer: str) -> Held | None:
    """Best refit with the finer law; its first parameter starts where the coarse law's stands."""
    try:
        here = search.moved(held, [finer])
    except CannotFinishError:
        return None
    stand, study = here.stand, here.stand.study
    parameters = study.parameters
    values = parameters.from_search(here.optimum.coordinates)
    old, new = stand.candidates[coarse], stand.candidates[finer]
    rows = []
    for shape in product(*(sorted({start[k] for start in new.starts}) for k in range(1, len(new.columns)))):
        at = values.copy()
        at[list(old.columns)] = parameters.start[list(old.columns)]
        at[new.columns[0]] = values[old.columns[0]]
        at[list(new.columns[1:])] = shape
        rows.append(parameters.to_search(at))
    effects = tuple(finer if e == coarse else e for e in here.effects)
    likelihood = [
        study.whiten(residual, None, here.optimum.noise).log_likelihood if residual is not None else -np.inf
        for residual in study.residuals(np.array(rows))
    ]
    best: Held | None = None
    for k in np.argsort(likelihood)[::-1][:STARTS]:
        try:
            found = climb(study, rows[k], stand.free(effects), noise=here.optimum.noise, settings=search.fit)
        except CannotFinishError:
            continue
        if best is None or found.log_evidence > best.log_evidence:
            best = Held(stand, effects, found)
    return best
