"""Checks that a structure must pass before its terms are named; they see the fitted readings only."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from aero_bayes.check.residual_tests import MAX_FLOOR_RATIO, ResidualReport, structured_residuals
from aero_bayes.display import join_names
from aero_bayes.judge.holdout import held_out_gain
from aero_bayes.search.explored import Explored
from aero_bayes.search.models import FittedModel
from aero_bayes.search.score import common_noise
from aero_bayes.search.structure import Structure

#: Smallest number of readings for each free parameter.
MIN_READINGS_PER_PARAMETER = 5
#: Standard errors by which a term has to improve the prediction of readings that were left out.
MIN_STANDARD_ERRORS = 2.0
#: Ratio of residual to noise floor below which structure in the residual is ignored.
MIN_VISIBLE_FLOOR_RATIO = 1.1


@dataclass(frozen=True)
class Verdict:
    """What a check says of a structure: whether it passed, and in words why not."""

    check: str
    passed: bool
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Case:
    """A structure before the checks.

    Parameters
    ----------
    fitted : FittedModel
    explored : Explored
        All structures that were fitted.
    before, after : sequences of ResidualReport
        Of the first model and of this one.
    """

    fitted: FittedModel
    explored: Explored
    before: Sequence[ResidualReport]
    after: Sequence[ResidualReport]


class Check(Protocol):
    """Judges a structure on the fitted readings."""

    def judge(self, case: Case) -> Verdict:
        """Whether its terms may be named."""
        ...


class EnoughReadings:
    """There have to be several readings for each free parameter."""

    def judge(self, case: Case) -> Verdict:
        readings, parameters = case.fitted.optimum.whitened.readings, len(case.fitted.optimum.free)
        few = readings < MIN_READINGS_PER_PARAMETER * parameters
        reason = f"{readings} readings are too few for {parameters} free parameters" if few else ""
        return Verdict("EnoughReadings", not few, reason)


class PaysItsPrice:
    """Each term has to gain what it pays for having been looked for."""

    def judge(self, case: Case) -> Verdict:
        fits, own = case.explored.fits, case.explored.price.score(case.fitted)
        rests = {t: fits.get(case.fitted.structure.minus(t)) for t in case.fitted.terms}
        free = [t for t, rest in rests.items() if rest is not None and case.explored.price.score(rest) > own]
        reason = f"the gain is below the price: {join_names(free)}" if free else ""
        return Verdict("PaysItsPrice", not free, reason)


class LeaveBlockOut:
    """Each term has to improve the prediction of readings that are left out by two standard errors."""

    def judge(self, case: Case) -> Verdict:
        fits, noise = case.explored.fits, case.explored.noise.noise
        weak = []
        for id_ in case.fitted.terms:
            rival = fits.get(case.fitted.structure.minus(id_))
            if rival is not None:
                found = held_out_gain(case.fitted.with_noise(noise), rival.with_noise(noise))
                if found.in_errors < MIN_STANDARD_ERRORS:
                    weak.append(f"{id_} by {found.in_errors:.1f} standard errors over {found.blocks} {found.by}")
        reason = f"readings that were left out are not surely predicted better: {join_names(weak)}" if weak else ""
        return Verdict("LeaveBlockOut", not weak, reason)


@dataclass(frozen=True)
class LeftOver:
    """What is left above the noise floor has to be a small share of what there was.

    Parameters
    ----------
    share : float
        Greatest share of the squared error above the floor, over all outputs and in each that is far above its floor.
    """

    share: float = 0.3

    def judge(self, case: Case) -> Verdict:
        before = {(r.recording, r.output): r for r in case.before}
        pairs = [(before[r.recording, r.output], r) for r in case.after]
        left = [
            (one, other)
            for one, other in pairs
            if other.verdict == "structured" and other.ratio >= MIN_VISIBLE_FLOOR_RATIO
        ]
        far = [pair for pair in left if pair[1].ratio > MAX_FLOOR_RATIO or pair[1].noise_floor is None]
        if not left or not (self._is_much(pairs) or any(self._is_much([pair]) for pair in far)):
            return Verdict("LeftOver", True)
        outputs = join_names(sorted({r.output for _, r in left}))
        reason = f"more than {self.share:.0%} of the error above the noise is left in {outputs}"
        return Verdict("LeftOver", False, reason)

    def _is_much(self, pairs: Sequence[tuple[ResidualReport, ResidualReport]]) -> bool:
        """Whether too much of the squared error above the floor is left.

        Nothing is left in an output that is down to its noise. A floor that is not known counts as none, and the unit
        of that output is its estimated noise.
        """
        first = last = 0.0
        for one, other in pairs:
            floor = (one.noise_floor or 0.0) if other.verdict == "structured" else other.rms
            unit = max(one.noise_floor or other.noise, 1e-3 * one.rms, 1e-300)
            first += max((one.rms / unit) ** 2 - (floor / unit) ** 2, 0.0)
            last += max((other.rms / unit) ** 2 - (floor / unit) ** 2, 0.0)
        return last > self.share * first


def reports_of(fitted: FittedModel, explored: Explored) -> tuple[ResidualReport, ...]:
    """What a fit leaves, against its own noise."""
    return common_noise(fitted, explored.floors).reports


@dataclass(frozen=True, eq=False)
class Choice:
    """The structure that is named, and those that were better but failed a check, with the reasons.

    ``before`` and ``after`` are what the first model and the chosen one leave; ``explored`` are all structures, those
    among them that the checks asked for.
    """

    fitted: FittedModel
    before: tuple[ResidualReport, ...]
    after: tuple[ResidualReport, ...]
    refused: tuple[tuple[FittedModel, Verdict], ...]
    explored: Explored


def choose(
    explored: Explored,
    checks: Sequence[Check],
    required: Sequence[str] = (),
    complete: Callable[[FittedModel], Explored] | None = None,
) -> Choice:
    """The best structure that passes all checks; the first model where none does.

    Parameters
    ----------
    explored : Explored
    checks : sequence of Check
    required : sequence of str
        Terms that need not pass.
    complete : callable, optional
        Fits a structure without each of its terms where that was not fitted, and gives all that was found.
    """
    before = reports_of(explored.first_model, explored)
    refused: dict[Structure, tuple[FittedModel, Verdict]] = {}
    while True:
        left = [f for f in explored.ranked if set(required) <= set(f.terms) and f.structure not in refused]
        fitted = left[0] if left else explored.first_model
        if not left or set(fitted.terms) == set(required):
            return Choice(fitted, before, reports_of(fitted, explored), tuple(refused.values()), explored)
        rests = [fitted.structure.minus(t) for t in fitted.terms]
        if complete is not None and any(s not in explored.fits for s in rests):
            # Without one of its terms it may be better than with it.
            explored = complete(fitted)
            if all(s in explored.fits for s in rests):
                continue
        case = Case(fitted, explored, before, reports_of(fitted, explored))
        failed = next((v for check in checks if not (v := check.judge(case)).passed), None)
        if failed is None:
            return Choice(fitted, before, tuple(case.after), tuple(refused.values()), explored)
        refused[fitted.structure] = fitted, failed


def disturbed(reports: Sequence[ResidualReport], share: float = 0.8) -> tuple[str, float, float] | None:
    """Recording, start and end in s of a disturbance: a tenth of the recording holds most of what is left."""
    structured = [r for r in structured_residuals(reports) if r.worst_share > share and math.isfinite(r.ratio)]
    if not structured:
        return None
    worst = max(structured, key=lambda r: r.worst_share)
    return worst.recording, *worst.worst_time
