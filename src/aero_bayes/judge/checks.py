"""Checks that a structure must pass before its terms are named; they see the fitted readings only."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from aero_bayes.check.residual_tests import MAX_FLOOR_RATIO, ResidualReport, structured_residuals
from aero_bayes.display import join_names
from aero_bayes.judge.holdout import held_out_gain
from aero_bayes.search.explored import SearchResult
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
class CheckResult:
    """Result of a check: whether the structure passed, and why not."""

    check: str
    passed: bool
    reason: str = ""


@dataclass(frozen=True, eq=False)
class CheckInput:
    """What a check may look at.

    Parameters
    ----------
    fitted : FittedModel
    explored : SearchResult
        All structures that were fitted.
    before, after : sequences of ResidualReport
        Of the first model and of this one.
    """

    fitted: FittedModel
    explored: SearchResult
    before: Sequence[ResidualReport]
    after: Sequence[ResidualReport]


class Check(Protocol):
    """Judges a structure on the fitted readings."""

    def judge(self, given: CheckInput) -> CheckResult:
        """Whether its terms may be named."""
        ...


class EnoughReadings:
    """At least five readings for each free parameter."""

    def judge(self, given: CheckInput) -> CheckResult:
        readings, parameters = given.fitted.optimum.whitened.readings, len(given.fitted.optimum.free)
        few = readings < MIN_READINGS_PER_PARAMETER * parameters
        reason = f"{readings} readings are too few for {parameters} free parameters" if few else ""
        return CheckResult("EnoughReadings", not few, reason)


class EnoughEvidence:
    """Each term has to gain more log-evidence than its penalty for the number of candidates."""

    def judge(self, given: CheckInput) -> CheckResult:
        fits, own = given.explored.fits, given.explored.penalty.score(given.fitted)
        rests = {t: fits.get(given.fitted.structure.minus(t)) for t in given.fitted.terms}
        free = [t for t, rest in rests.items() if rest is not None and given.explored.penalty.score(rest) > own]
        reason = f"the gain in log-evidence of {join_names(free)} is too small" if free else ""
        return CheckResult("EnoughEvidence", not free, reason)


class LeaveBlockOut:
    """Each term has to improve the prediction of left-out blocks by two standard errors (cross-validation)."""

    def judge(self, given: CheckInput) -> CheckResult:
        fits, noise = given.explored.fits, given.explored.noise.noise
        weak = []
        for id_ in given.fitted.terms:
            rival = fits.get(given.fitted.structure.minus(id_))
            if rival is not None:
                found = held_out_gain(given.fitted.with_noise(noise), rival.with_noise(noise))
                if found.in_errors < MIN_STANDARD_ERRORS:
                    weak.append(f"{id_} ({found.in_errors:.1f} standard errors over {found.blocks} {found.by})")
        reason = (
            f"the prediction of left-out data improves by less than {MIN_STANDARD_ERRORS:g} standard errors with "
            f"{join_names(weak)}"
            if weak
            else ""
        )
        return CheckResult("LeaveBlockOut", not weak, reason)


@dataclass(frozen=True)
class LeftOver:
    """The squared error above the noise floor has to fall to a small share of that of the first model.

    Parameters
    ----------
    share : float
        Greatest share of the squared error above the floor, over all outputs and in each that is far above its floor.
    """

    share: float = 0.3

    def judge(self, given: CheckInput) -> CheckResult:
        before = {(r.recording, r.output): r for r in given.before}
        pairs = [(before[r.recording, r.output], r) for r in given.after]
        left = [
            (one, other)
            for one, other in pairs
            if other.verdict == "structured" and other.ratio >= MIN_VISIBLE_FLOOR_RATIO
        ]
        far = [pair for pair in left if pair[1].ratio > MAX_FLOOR_RATIO or pair[1].noise_floor is None]
        if not left or not (self._is_much(pairs) or any(self._is_much([pair]) for pair in far)):
            return CheckResult("LeftOver", True)
        outputs = join_names(sorted({r.output for _, r in left}))
        reason = f"more than {self.share:.0%} of the squared error above the noise floor remains in {outputs}"
        return CheckResult("LeftOver", False, reason)

    def _is_much(self, pairs: Sequence[tuple[ResidualReport, ResidualReport]]) -> bool:
        """Whether too large a share of the squared error above the floor remains.

        An output that is down to its noise counts as zero. An unknown floor counts as zero, and then the estimated
        noise is the unit of the output.
        """
        first = last = 0.0
        for one, other in pairs:
            floor = (one.noise_floor or 0.0) if other.verdict == "structured" else other.rms
            unit = max(one.noise_floor or other.noise, 1e-3 * one.rms, 1e-300)
            first += max((one.rms / unit) ** 2 - (floor / unit) ** 2, 0.0)
            last += max((other.rms / unit) ** 2 - (floor / unit) ** 2, 0.0)
        return last > self.share * first


def residual_reports(fitted: FittedModel, explored: SearchResult) -> tuple[ResidualReport, ...]:
    """Reports on the residuals of a fit, under its own noise."""
    return common_noise(fitted, explored.floors).reports


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen structure, and better ones that failed a check, with the reasons.

    ``before`` and ``after`` are what the first model and the chosen one leave; ``explored`` are all structures, those
    among them that the checks asked for.
    """

    fitted: FittedModel
    before: tuple[ResidualReport, ...]
    after: tuple[ResidualReport, ...]
    refused: tuple[tuple[FittedModel, CheckResult], ...]
    explored: SearchResult


def choose(
    explored: SearchResult,
    checks: Sequence[Check],
    required: Sequence[str] = (),
    complete: Callable[[FittedModel], SearchResult] | None = None,
) -> Choice:
    """Choose the best structure that passes all checks; the first model if none does.

    Parameters
    ----------
    explored : SearchResult
    checks : sequence of Check
    required : sequence of str
        Terms that need not pass.
    complete : callable, optional
        Fits a structure without each of its terms where that was not fitted, and gives all that was found.
    """
    before = residual_reports(explored.first_model, explored)
    refused: dict[Structure, tuple[FittedModel, CheckResult]] = {}
    while True:
        left = [f for f in explored.ranked if set(required) <= set(f.terms) and f.structure not in refused]
        fitted = left[0] if left else explored.first_model
        if not left or set(fitted.terms) == set(required):
            return Choice(fitted, before, residual_reports(fitted, explored), tuple(refused.values()), explored)
        rests = [fitted.structure.minus(t) for t in fitted.terms]
        if complete is not None and any(s not in explored.fits for s in rests):
            # The structure without one of its terms may turn out to be better.
            explored = complete(fitted)
            if all(s in explored.fits for s in rests):
                continue
        given = CheckInput(fitted, explored, before, residual_reports(fitted, explored))
        failed = next((v for check in checks if not (v := check.judge(given)).passed), None)
        if failed is None:
            return Choice(fitted, before, tuple(given.after), tuple(refused.values()), explored)
        refused[fitted.structure] = fitted, failed


def find_disturbance(reports: Sequence[ResidualReport], share: float = 0.8) -> tuple[str, float, float] | None:
    """Recording, start and end in s of a disturbance: a tenth of the recording has most of the squared residual."""
    structured = [r for r in structured_residuals(reports) if r.worst_share > share and math.isfinite(r.ratio)]
    if not structured:
        return None
    worst = max(structured, key=lambda r: r.worst_share)
    return worst.recording, *worst.worst_time
