"""Which effect does the model lack: every candidate is refitted with all parameters free and weighed by evidence.

The comparison is between log-evidences in Laplace's approximation, each model with its own most likely noise. A
candidate must gain more than the logarithm of the number of candidates and a margin; those within a stated difference
of the best are equivalent on this data.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.discrepancy.refit import Refit, RefitSettings, refit
from aero_bayes.discrepancy.study import Study
from aero_bayes.errors import CannotFinishError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Candidate:
    """An effect that the model may lack: the columns that switch it on, and values (SI units) to start them from."""

    id: str
    port: str
    columns: tuple[int, ...]
    starts: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class AttributeSettings:
    """When an effect has earned its place.

    ``margin`` is the log-evidence asked for beyond the logarithm of the number of candidates; ``equivalence`` is the
    difference in log-evidence within which two candidates count as equally good; ``starts`` is how many of the best
    starting magnitudes of a candidate are refitted.
    """

    margin: float = 4.0
    equivalence: float = 3.0
    starts: int = 2
    max_effects: int = 3


@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate beside those already chosen: its refit and its gain in log-evidence over the model without it."""

    candidate: Candidate
    refit: Refit | None
    gain: float


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the search: the candidates, best first, and what was made of them."""

    number: int
    base: Refit
    scores: tuple[Scored, ...]
    threshold: float
    chosen: Scored | None
    equivalent: tuple[str, ...]
    why: str


@dataclass(frozen=True, eq=False)
class Selection:
    """The effects that earned their place, in the order of their evidence, and how they were found."""

    effects: tuple[Candidate, ...]
    refit: Refit
    base: Refit
    rounds: tuple[Round, ...]
    equivalent: tuple[tuple[str, ...], ...]


def threshold(candidates: int, settings: AttributeSettings) -> float:
    """Least gain in log-evidence that counts as a discovery among so many candidates."""
    return math.log(max(candidates, 1)) + settings.margin


def starting_points(study: Study, base: Refit, candidate: Candidate) -> list[tuple[float, FloatArray]]:
    """Starting coordinates of a candidate, best first, with the misfit that a linear readjustment of the rest leaves.

    One plain simulation a start: the base parameters move along the base model's own sensitivities.
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
    curvature = slopes @ slopes.T + np.linalg.inv(base.covariance + 1e-30 * np.eye(len(base.free))) * 1e-6
    first, second = parameters.prior_derivatives(base.coordinates)
    free = list(base.free)
    curvature = slopes @ slopes.T + np.diag(np.maximum(-second[free], 1e-9))
    points = []
    for row, residual in zip(rows, study.residuals(rows), strict=True):
        if residual is None:
            continue
        white = study.whiten(residual, None, base.noise).residual
        gradient = slopes @ white + first[free]
        step = np.linalg.solve(curvature, gradient)
        left = float(white @ white) - float(step @ gradient)
        start = row.copy()
        start[free] = np.clip(row[free] + step, low[free], high[free])
        points.append((left, start))
    return sorted(points, key=lambda point: point[0])


def score(
    study: Study, base: Refit, candidate: Candidate, settings: AttributeSettings, fit: RefitSettings
) -> Scored:
    """Refit the model with one more effect, from the most promising of its starts."""
    free = base.free + candidate.columns
    best: Refit | None = None
    for _, start in starting_points(study, base, candidate)[: settings.starts]:
        try:
            found = refit(study, start, free, noise=base.noise, settings=fit)
        except CannotFinishError:
            continue
        if best is None or found.log_evidence > best.log_evidence:
            best = found
    return Scored(candidate, best, best.log_evidence - base.log_evidence if best is not None else -math.inf)


def search_round(
    study: Study,
    base: Refit,
    candidates: Sequence[Candidate],
    number: int,
    settings: AttributeSettings,
    fit: RefitSettings,
) -> Round:
    """Score all candidates beside what the model has already."""
    scores = sorted(
        (score(study, base, candidate, settings, fit) for candidate in candidates), key=lambda s: -s.gain
    )
    bar = threshold(len(candidates), settings)
    best = scores[0] if scores else None
    if best is None or best.refit is None or best.gain < bar:
        name = f"the best, {best.candidate.id}, gains {best.gain:.1f}" if best is not None else "there is none"
        return Round(number, base, tuple(scores), bar, None, (), f"no candidate gains {bar:.1f} in log-evidence: {name}")
    equal = tuple(s.candidate.id for s in scores if s.gain >= best.gain - settings.equivalence and s.gain >= bar)
    why = f"{best.candidate.id} gains {best.gain:.1f} in log-evidence (needed {bar:.1f})"
    if len(equal) > 1:
        why += f"; {', '.join(equal[1:])} within {settings.equivalence:g} of it"
    return Round(number, base, tuple(scores), bar, best, equal, why)
