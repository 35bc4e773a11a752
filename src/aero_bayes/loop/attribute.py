"""Which effect does the model lack: every candidate is refitted with all parameters free and weighed by evidence.

The comparison is between log-evidences in Laplace's approximation, each model with its own most likely noise. A
candidate must gain more than the logarithm of the number of candidates and a margin; those within a stated difference
of the best are equivalent on this data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.estimate.objective import Objective
from aero_bayes.physics.kin import Candidate

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class AttributeSettings:
    """When an effect has earned its place.

    ``margin`` is the log-evidence asked for beyond the logarithm of the number of candidates; ``equivalence`` is the
    difference in log-evidence within which the data do not tell two candidates apart (a hundred to one); ``starts`` is
    how many of the best starting magnitudes of a candidate are refitted, if one of them promises a gain in
    log-likelihood of ``promise``.
    """

    margin: float = 4.0
    equivalence: float = 4.6
    starts: int = 2
    promise: float = 2.0
    max_effects: int = 3


@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate beside those already chosen: its refit and its gain in log-evidence over the model without it.

    ``promise`` is the gain in log-likelihood that one simulation foretold; where it is tiny there is no refit.
    """

    candidate: Candidate
    refit: Optimum | None
    gain: float
    promise: float = 0.0


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the search: the candidates, best first, and what was made of them."""

    number: int
    base: Optimum
    scores: tuple[Scored, ...]
    threshold: float
    chosen: Scored | None
    equivalent: tuple[str, ...]
    why: str


@dataclass(frozen=True, eq=False)
class Selection:
    """The effects that earned their place, in the order of their evidence, and how they were found."""

    effects: tuple[Candidate, ...]
    refit: Optimum
    base: Optimum
    rounds: tuple[Round, ...]
    equivalent: tuple[tuple[str, ...], ...]


def threshold(candidates: int, settings: AttributeSettings) -> float:
    """Least gain in log-evidence that counts as a discovery among so many candidates."""
    return math.log(max(candidates, 1)) + settings.margin


def starting_points(study: Objective, base: Optimum, candidate: Candidate) -> list[tuple[float, FloatArray]]:
    """Starting coordinates of a candidate, best first, each with the gain in log-likelihood that it promises.

    One plain simulation a start. What it changes in the outputs, after the other parameters have readjusted along
    their own sensitivities, is a direction in the space of residuals; how far to go along it and what that gains under
    the present noise follow in closed form.
    """
    parameters = study.parameters
    columns = list(candidate.columns)
    low, high = parameters.box
    values = parameters.from_search(base.coordinates)
    rows = np.repeat(base.coordinates[np.newaxis, :], len(candidate.starts), axis=0)
    for k, start in enumerate(candidate.starts):
        at = values.copy()
        at[columns] = start
        rows[k, columns] = parameters.to_search(at)[columns]
    slopes = base.whitened.slopes
    free = list(base.free)
    _, second = parameters.prior_derivatives(base.coordinates)
    curvature = slopes @ slopes.T + np.diag(np.maximum(-second[free], 1e-9))
    points = []
    for row, residual in zip(rows, study.residuals(rows), strict=True):
        if residual is None:
            continue
        change = base.whitened.residual - study.whiten(residual, None, base.noise).residual
        back = np.linalg.solve(curvature, slopes @ change)
        direction = change - back @ slopes
        power = float(direction @ direction)
        if power <= 0.0:
            continue
        along = float(direction @ base.whitened.residual) / power
        start = row.copy()
        # The first column of an effect is its magnitude, zero where the effect is off.
        reach = float(np.clip(along, 0.05, 3.0))
        start[columns[0]] = np.clip(reach * row[columns[0]], low[columns[0]], high[columns[0]])
        start[free] = np.clip(base.coordinates[free] - reach * back, low[free], high[free])
        points.append((0.5 * max(along, 0.0) ** 2 * power, start))
    return sorted(points, key=lambda point: -point[0])


def score(
    study: Objective, base: Optimum, candidate: Candidate, settings: AttributeSettings, fit: ClimbSettings
) -> Scored:
    """Refit the model with one more effect, from the most promising of its starts.

    A candidate that promises almost nothing at any start is not refitted.
    """
    free = base.free + candidate.columns
    points = starting_points(study, base, candidate)
    if not points or points[0][0] < settings.promise:
        return Scored(candidate, None, min(points[0][0], 0.0) if points else -math.inf, points[0][0] if points else 0.0)
    best: Optimum | None = None
    for promise, start in points[: settings.starts]:
        if best is not None and promise < 0.3 * points[0][0]:
            break
        try:
            found = climb(study, start, free, noise=base.noise, settings=fit)
        except CannotFinishError:
            continue
        if best is None or found.log_evidence > best.log_evidence:
            best = found
    gain = best.log_evidence - base.log_evidence if best is not None else -math.inf
    return Scored(candidate, best, float(gain), points[0][0])


def search_round(
    study: Objective,
    base: Optimum,
    candidates: Sequence[Candidate],
    number: int,
    settings: AttributeSettings,
    fit: ClimbSettings,
) -> Round:
    """Score all candidates beside what the model has already."""
    scores = sorted((score(study, base, candidate, settings, fit) for candidate in candidates), key=lambda s: -s.gain)
    bar = threshold(len(candidates), settings)
    best = scores[0] if scores else None
    if best is None or best.refit is None or best.gain < bar:
        name = f"the best, {best.candidate.id}, gains {best.gain:.1f}" if best is not None else "there is none"
        return Round(
            number, base, tuple(scores), bar, None, (), f"no candidate gains {bar:.1f} in log-evidence: {name}"
        )
    equal = tuple(s.candidate.id for s in scores if s.gain >= best.gain - settings.equivalence and s.gain >= bar)
    why = f"{best.candidate.id} gains {best.gain:.1f} in log-evidence (needed {bar:.1f})"
    if len(equal) > 1:
        why += f"; {', '.join(equal[1:])} within {settings.equivalence:g} of it"
    return Round(number, base, tuple(scores), bar, best, equal, why)


def select(
    study: Objective,
    base: Optimum,
    candidates: Sequence[Candidate],
    settings: AttributeSettings,
    fit: ClimbSettings,
    told: Callable[[str, float], None] | None = None,
) -> Selection:
    """Forward selection, one effect a round; at the end drop and swap over the whole list.

    A first effect may explain only half of what is missing, so that a wrong one can win the first round.
    """
    told = told or (lambda text, share: None)
    rounds: list[Round] = []
    chosen: list[Candidate] = []
    current = base
    bar = threshold(len(candidates), settings)
    for number in range(1, settings.max_effects + 1):
        told(f"round {number}", (number - 1) / (settings.max_effects + 1))
        rest = [c for c in candidates if c not in chosen]
        found = search_round(study, current, rest, number, settings, fit)
        rounds.append(found)
        if found.chosen is None or found.chosen.refit is None:
            break
        chosen.append(found.chosen.candidate)
        current = found.chosen.refit
    equivalent: list[tuple[str, ...]] = [found.equivalent for found in rounds if found.chosen is not None]
    if len(chosen) > 1:
        told("drop and swap", settings.max_effects / (settings.max_effects + 1))
        for _ in range(2):
            changed = False
            equivalent = []
            for effect in list(chosen):
                others = [c for c in chosen if c is not effect]
                without = _without(study, current, effect, fit)
                if current.log_evidence - without.log_evidence < bar:
                    chosen, current, changed = others, without, True
                    continue
                rest = [c for c in candidates if c not in others]
                found = search_round(study, without, rest, len(rounds) + 1, settings, fit)
                best = found.scores[0]
                if best.refit is not None and best.refit.log_evidence > current.log_evidence + 0.1:
                    changed = changed or best.candidate is not effect
                    chosen = [*others, best.candidate]
                    current = best.refit
                    rounds.append(found)
                same = tuple(
                    s.candidate.id
                    for s in found.scores
                    if s.refit is not None and s.refit.log_evidence > current.log_evidence - settings.equivalence
                )
                equivalent.append(same)
            if not changed:
                break
    return Selection(tuple(chosen), current, base, tuple(rounds), tuple(e for e in equivalent if len(e) > 1))


def _without(study: Objective, fit: Optimum, effect: Candidate, settings: ClimbSettings) -> Optimum:
    """The model with one effect switched off, refitted."""
    start = fit.coordinates.copy()
    off = study.parameters.to_search(study.parameters.start)
    start[list(effect.columns)] = off[list(effect.columns)]
    free = tuple(j for j in fit.free if j not in effect.columns)
    return climb(study, start, free, noise=fit.noise, settings=settings)
