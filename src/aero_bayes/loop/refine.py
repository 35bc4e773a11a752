"""A finer law for an effect that was found: it takes the simple one's place where the data ask for its parameters.

The finer law has the simple one as a limit, so that it always fits at least as well; searched for beside the simple
one it would win or lose by chance. It is tried only after the search, and has to gain as much as a discovery; where it
gains less than that, the two are equivalent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.climb import climb
from aero_bayes.loop.attribute import SWAP, Search
from aero_bayes.loop.prospect import Scored
from aero_bayes.loop.rounds import Round, Selection, threshold, with_odds
from aero_bayes.loop.stand import Held
from aero_bayes.show import listed

#: Refits of a finer law, from the likeliest of its starts.
STARTS = 2


def refine(search: Search, selection: Selection, finer: Mapping[str, str], count: int) -> Selection:
    """The selection with each of its effects in the finer law that earns its place best.

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
    by_coarse: dict[str, list[str]] = {}
    for id_, coarse in finer.items():
        by_coarse.setdefault(coarse, []).append(id_)
    for coarse, ids in by_coarse.items():
        taken = {coarse, *ids} & {*selection.effects}
        if taken != {coarse} or coarse in search.settings.require:
            continue
        scores = _scored(search, selection.held, coarse, ids)
        if not scores or scores[0].gain < bar:
            plainer = _plainer(search, selection, scores, bar)
            if plainer is not None:
                selection = plainer
                continue
            for score in (s for s in scores if s.gain > 0.0):
                selection = replace(selection, equivalent=_with(selection.equivalent, coarse, score.candidate.id))
            continue
        rated, nothing, untried = with_odds(scores)
        best, near = rated[0], max(bar, rated[0].gain - search.settings.equivalence)
        id_, *others = (s.candidate.id for s in rated if s is best or s.gain > near)
        for other in others:
            selection = replace(selection, equivalent=_with(selection.equivalent, id_, other))
        why = f"{id_} in place of {coarse} gains {best.gain:.1f} in log-evidence (needed {bar:.1f})"
        number = len(selection.rounds) + 1
        last = Round(number, selection.held, rated, bar, best, (id_, *others), why, nothing, untried)
        assert best.held is not None
        selection = replace(selection, held=best.held, rounds=(*selection.rounds, last))
        selection = _dropped(search, selection, id_, bar)
    return selection


def _scored(search: Search, held: Held, coarse: str, ids: Sequence[str]) -> list[Scored]:
    """What each finer law gains in the place of the simple one, best first; nothing where its shape is not seen."""
    scores = []
    for id_ in ids:
        found = _in_place_of(search, held, coarse, id_)
        if found is not None:
            # The evidence is that of a detail, not of the law.
            gain = found.log_evidence - held.log_evidence if found.shows_shape(id_) else 0.0
            scores.append(Scored(found.stand.candidates[id_], found, gain, gain))
    return sorted(scores, key=lambda s: -s.gain)


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


def _plainer(search: Search, selection: Selection, scores: Sequence[Scored], bar: float) -> Selection | None:
    """The selection with a finer law that does alone, within ``SWAP``, what the simple one needs others for."""
    now = selection.held.log_evidence
    if len(selection.effects) < 2:
        return None
    found: list[tuple[Scored, Selection]] = []
    for score in scores:
        assert score.held is not None
        slim = _dropped(search, replace(selection, held=score.held), score.candidate.id, bar)
        if len(slim.effects) < len(selection.effects) and slim.held.shows_shape(score.candidate.id):
            gain = slim.held.log_evidence - now
            found.append((replace(score, held=slim.held, gain=gain, promise=gain), slim))
    best, slim = max(found, key=lambda f: f[0].gain, default=(None, selection))
    if best is None or best.gain < -SWAP:
        return None
    gone = [e for e in selection.effects if e not in slim.effects]
    why = f"{best.candidate.id} in place of {listed(gone)} gains {best.gain:.1f} in log-evidence"
    rated, nothing, untried = with_odds([best])
    number, same = len(selection.rounds) + 1, (best.candidate.id,)
    last = Round(number, selection.held, rated, 0.0, rated[0], same, why, nothing, untried)
    return replace(slim, rounds=(*selection.rounds, last))


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
