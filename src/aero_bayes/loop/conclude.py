"""What the loop concludes: an outcome, the model behind it with its fit, and the sentences that say why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.check.residual_tests import MAX_FLOOR_RATIO, ResidualReport, structured_residuals
from aero_bayes.display import join_names
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.judge.checks import Check, Choice, EnoughReadings, LeaveBlockOut, LeftOver, PaysItsPrice, disturbed
from aero_bayes.judge.prediction import Prediction, gain_text
from aero_bayes.judge.validation import far_off, refusal
from aero_bayes.laws.model_family import ExtendedModel
from aero_bayes.loop.base_fit import BaseFit, refit_base
from aero_bayes.loop.extend import ExtendedFit, extend
from aero_bayes.loop.found_effect import FoundEffect
from aero_bayes.loop.result import LoopOutcome
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.loop.steps import Step, equivalents, steps_of
from aero_bayes.loop.workbench import Workbench
from aero_bayes.search.explored import Explored
from aero_bayes.search.models import FittedModel

#: Largest number of equivalent alternatives that are listed by name.
MAX_NAMED_ALTERNATIVES = 2
#: Effective samples for each free parameter below which nothing can be told.
MIN_SAMPLES_PER_PARAMETER = 3.0


@dataclass(frozen=True, eq=False)
class Conclusion:
    """One way to end the loop.

    Parameters
    ----------
    base : BaseFit
        The first model at its best, its inputs read and its parameters freed as in the chosen structure.
    explored : Explored
    chosen : FittedModel
        The structure that passed the checks on the fitted readings.
    steps : tuple of Step
    outcome : {"adequate", "extended", "unexplained"}
    sentence : str
    before, after : Prediction
    written : Extension, optional
    effects : tuple of FoundEffect
    calibration : Calibration
    refit : Optimum
        The last fit, of ``calibration``.
    reports : tuple of ResidualReport
        What it leaves.
    """

    base: BaseFit
    explored: Explored
    chosen: FittedModel
    steps: tuple[Step, ...]
    outcome: LoopOutcome
    sentence: str
    before: Prediction
    after: Prediction
    written: ExtendedModel | None
    effects: tuple[FoundEffect, ...]
    calibration: Calibration
    refit: Optimum
    reports: tuple[ResidualReport, ...]


def conclude(bench: Workbench, base: BaseFit, choice: Choice) -> Conclusion:
    """Name the structure that was chosen, unless unseen readings refuse it."""
    settings, explored, chosen = bench.settings, choice.explored, choice.fitted
    within = settings.structures.equivalence
    base = refit_base(bench, base, _first_of(explored, chosen))
    before = bench.unseen.predict(base.plain, base.fit)
    bench.tally.lap("judgement")
    if not chosen.terms:
        return _nothing_named(bench, base, explored, choice, before)
    steps = steps_of(explored, chosen, within)
    try:
        extended = extend(bench, base, explored, chosen)
    except CannotFinishError:
        why = f"{_explain(chosen)}, but with {_them(chosen)} the model cannot be simulated on unseen data."
        return _unexplained(base, explored, chosen, steps, why, before)
    if "Validation" not in settings.leave_out and not settings.structures.require:
        reason = refusal(before, extended.after, bench.recordings, extended.reports)
        if reason:
            why = f"{_explain(chosen)}, but {reason} The missing physics is something else."
            return _unexplained(base, explored, chosen, steps, why, before)
    sentence = _added(bench, explored, chosen, extended, before)
    return Conclusion(
        base, explored, chosen, steps, "extended", sentence, before, extended.after, extended.written,
        extended.effects, extended.calibration, extended.fit, extended.reports,
    )  # fmt: skip


def checks_of(settings: LoopSettings) -> list[Check]:
    """What a structure has to pass."""
    standard: tuple[Check, ...] = (EnoughReadings(), PaysItsPrice(), LeaveBlockOut(), LeftOver(settings.left_over))
    return [c for c in settings.checks or standard if type(c).__name__ not in settings.leave_out]


def _first_of(explored: Explored, chosen: FittedModel) -> FittedModel:
    """The first model, its inputs read and its parameters freed as in a structure."""
    return explored.fits.get(chosen.structure.minus(*chosen.terms), chosen)


def _nothing_named(
    bench: Workbench, base: BaseFit, explored: Explored, choice: Choice, before: Prediction
) -> Conclusion:
    within = bench.settings.structures.equivalence
    best = choice.refused[0][0] if choice.refused else choice.fitted
    steps = steps_of(explored, best, within)
    structured = structured_residuals(base.reports)
    last = steps[-1].why if steps else "nothing was tried"
    far = far_off(bench.unseen, base.plain, base.fit, base.reports, base.floors, before, bench.settings.times_fitted)
    if not structured and not choice.refused:
        sentence = f"The model is adequate for these recordings: {last}."
        if far.beyond:
            sentence = (
                "The fitted readings ask for no more, but unseen data are missed by far: "
                f"{_in_words(far.beyond)}. The fitted readings do not show what is missing, or do not fix the "
                "parameters well enough."
            )
            return _unexplained(base, explored, choice.fitted, steps, sentence, before)
        if far.sensitive:
            sentence += (
                f" Unseen data are sensitive to the parameters: {_in_words(far.sensitive)}, as their uncertainty lets "
                "expect."
            )
        return Conclusion(
            base, explored, choice.fitted, steps, "adequate", sentence, before, before, None, (), base.plain, base.fit,
            base.reports,
        )  # fmt: skip
    sentence = _why_not(base, explored, choice, structured, last)
    return _unexplained(base, explored, choice.fitted, steps, sentence, before)


def _why_not(base: BaseFit, explored: Explored, choice: Choice, structured: Sequence[ResidualReport], last: str) -> str:
    """Why a residual with structure gets no name."""
    moment = disturbed(base.reports)
    if moment is not None:
        recording, start, stop = moment
        return (
            f"Most of what is left in {recording} belongs to one moment, from {start:.3g} s to {stop:.3g} s: a "
            "disturbance that is not made into physics."
        )
    parameters, samples = len(explored.first_model.optimum.free), explored.noise.total_samples
    if samples < MIN_SAMPLES_PER_PARAMETER * parameters:
        return (
            f"The readings count for {samples:.0f} independent ones, too few beside {parameters} free parameters to "
            "tell what is missing."
        )
    if choice.refused:
        best, verdict = choice.refused[0]
        return f"{_explain(best)}, but is not named: {verdict.reason}."
    worst = max(structured, key=lambda r: r.ratio)
    return (
        f"The residual of {worst.output} is structured ({_ratio(worst.ratio)} times the noise floor; it "
        f"{_how(worst)}), but no term of the library explains it: {last}."
    )


def _unexplained(
    base: BaseFit,
    explored: Explored,
    chosen: FittedModel,
    steps: tuple[Step, ...],
    why: str,
    before: Prediction,
) -> Conclusion:
    return Conclusion(
        base, explored, chosen, steps, "unexplained", why, before, before, None, (), base.plain, base.fit,
        base.reports,
    )  # fmt: skip


def _explain(fitted: FittedModel) -> str:
    verb = "explain" if len(fitted.terms) > 1 else "explains"
    return f"The residual is structured; {join_names(list(fitted.terms))} {verb} part of it where it was fitted"


def _them(fitted: FittedModel) -> str:
    return "them" if len(fitted.terms) > 1 else "it"


def _added(bench: Workbench, explored: Explored, chosen: FittedModel, extended: ExtendedFit, before: Prediction) -> str:
    required = bench.settings.structures.require
    told = sorted(extended.effects, key=lambda e: e.kind)  # what has a name first
    same = {t: equivalents(explored, chosen, t, bench.settings.structures.equivalence) for t in chosen.terms}
    given, lacking = ([_named(e, same[e.id]) for e in told if (e.id in required) is asked] for asked in (True, False))
    said = [f"was given {join_names(given)}, as required"] if given else []
    said += [f"lacks {join_names(lacking)}"] if lacking else []
    sentence = f"The model {', and '.join(said)}: {gain_text(before, extended.after, bench.units)}"
    structured = structured_residuals(extended.reports)
    return sentence + (f" Some structure is left in {', '.join(_left(structured))}." if structured else "")


def _named(effect: FoundEffect, same: Sequence[str]) -> str:
    """An effect, and what it may be instead: the data cannot tell."""
    if effect.kind == "catalogue":
        others = [other for other in same if other != effect.id]
        if not others:
            return effect.id
        instead = " or ".join(others) if len(others) <= MAX_NAMED_ALTERNATIVES else f"one of {len(others)} others"
        return f"{effect.id} (or {instead}, which the data cannot tell from it)"
    return f"something at {effect.port} that no listed law describes, learned as a curve over {effect.over}"


def _left(structured: Sequence[ResidualReport]) -> list[str]:
    """Outputs with structure, with how far it is above the noise where it is far."""
    worst: dict[str, float] = {}
    for report in structured:
        worst[report.output] = max(report.ratio, worst.get(report.output, 0.0))
    return [
        f"{o} ({_ratio(worst[o])} times the noise floor)" if worst[o] > MAX_FLOOR_RATIO else o for o in sorted(worst)
    ]


def _ratio(ratio: float) -> str:
    return f"{ratio:.2g}" if ratio < 100.0 and math.isfinite(ratio) else "more than a hundred"


def _how(report: ResidualReport) -> str:
    """What tells that a residual is no noise."""
    if report.ratio > MAX_FLOOR_RATIO or not report.tests:
        return "is far from it"
    plainest = min(report.tests, key=lambda t: t.p_value).name
    return {"autocorrelation": "is not white", "slow": "drifts"}.get(plainest, f"depends on {plainest}")


def _in_words(far: Mapping[tuple[str, str], float]) -> str:
    """Outputs with the worst of their ratios."""
    worst: dict[str, float] = {}
    for (_, output), ratio in far.items():
        worst[output] = max(ratio, worst.get(output, 0.0))
    return ", ".join(f"{output} ({ratio:.2g} times what the fit leaves)" for output, ratio in worst.items())
