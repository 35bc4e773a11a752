"""A finer law for an effect that was found: it takes the simple one's place where the data ask for its parameters.

The finer law has the simple one as a limit, so that it always fits at least as well; searched for beside the simple
one it would win or lose by chance. It is tried only after the search, and has to gain as much as a discovery; where it
gains less than that, the two are equivalent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.estimate.objective import Objective
from aero_bayes.loop.attribute import AttributeSettings, Round, Scored, Selection, threshold
from aero_bayes.physics.kin import Candidate

#: Refits of a finer law, from the likeliest of its starts.
STARTS = 2


def refine(
    study: Objective,
    selection: Selection,
    candidates: Sequence[Candidate],
    settings: AttributeSettings,
    fit: ClimbSettings,
) -> Selection:
    """The selection with each of its effects in the finest law that earns its place.

    Parameters
    ----------
    candidates : sequence of Candidate
        All of them; those that refine a chosen one are tried.
    """
    simple = [c for c in candidates if not c.refines]
    bar = threshold(len(simple), settings)
    for finer in candidates:
        coarse = next((c for c in selection.effects if c.id == finer.refines), None)
        if coarse is None:
            continue
        found = _in_place_of(study, selection.refit, coarse, finer, fit)
        if found is None:
            continue
        gain = found.log_evidence - selection.refit.log_evidence
        if gain < bar:
            if gain > 0.0:
                selection = replace(selection, equivalent=_with(selection.equivalent, coarse.id, finer.id))
            continue
        scored = Scored(finer, found, gain, gain)
        why = f"{finer.id} in place of {coarse.id} gains {gain:.1f} in log-evidence (needed {bar:.1f})"
        last = Round(len(selection.rounds) + 1, selection.refit, (scored,), bar, scored, (finer.id,), why)
        selection = replace(
            selection,
            effects=tuple(finer if c is coarse else c for c in selection.effects),
            refit=found,
            rounds=(*selection.rounds, last),
        )
        selection = _dropped(study, selection, finer, bar, fit)
    return selection


def _with(classes: tuple[tuple[str, ...], ...], member: str, other: str) -> tuple[tuple[str, ...], ...]:
    """Classes of equivalent effects with ``other`` beside ``member``."""
    if any(member in ids for ids in classes):
        return tuple((*ids, other) if member in ids else ids for ids in classes)
    return (*classes, (member, other))


def _dropped(study: Objective, selection: Selection, kept: Candidate, bar: float, settings: ClimbSettings) -> Selection:
    """The selection without effects that only made up for what the finer law now tells."""
    off = study.parameters.to_search(study.parameters.start)
    for other in [c for c in selection.effects if c is not kept]:
        columns = list(other.columns)
        start = selection.refit.coordinates.copy()
        start[columns] = off[columns]
        free = tuple(j for j in selection.refit.free if j not in columns)
        without = climb(study, start, free, noise=selection.refit.noise, settings=settings)
        if selection.refit.log_evidence - without.log_evidence < bar:
            left = tuple(c for c in selection.effects if c is not other)
            same = tuple(ids for ids in selection.equivalent if other.id not in ids)
            selection = replace(selection, effects=left, refit=without, equivalent=same)
    return selection


def _in_place_of(
    study: Objective, fit: Optimum, coarse: Candidate, finer: Candidate, settings: ClimbSettings
) -> Optimum | None:
    """Best refit with the finer law; its first parameter starts where the coarse law's stands."""
    parameters = study.parameters
    values = parameters.from_search(fit.coordinates)
    off = parameters.start
    rows = []
    for shape in product(*(sorted({start[k] for start in finer.starts}) for k in range(1, len(finer.columns)))):
        at = values.copy()
        at[list(coarse.columns)] = off[list(coarse.columns)]
        at[finer.columns[0]] = values[coarse.columns[0]]
        at[list(finer.columns[1:])] = shape
        rows.append(parameters.to_search(at))
    free = (*(j for j in fit.free if j not in coarse.columns), *finer.columns)
    likelihood = [
        study.whiten(residual, None, fit.noise).log_likelihood if residual is not None else -np.inf
        for residual in study.residuals(np.array(rows))
    ]
    best: Optimum | None = None
    for k in np.argsort(likelihood)[::-1][:STARTS]:
        try:
            found = climb(study, rows[k], free, noise=fit.noise, settings=settings)
        except CannotFinishError:
            continue
        if best is None or found.log_evidence > best.log_evidence:
            best = found
    return best
