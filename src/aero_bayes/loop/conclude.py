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
from aero_bayes.judge.checks import (
    Check,
    Choice,
    EnoughEvidence,
    EnoughReadings,
    LeaveBlockOut,
    LeftOver,
    find_disturbance,
)
from aero_bayes.judge.prediction import Prediction, describe_error_change
from aero_bayes.judge.validation import far_off, refusal
from aero_bayes.laws.model_family import ExtendedModel
from aero_bayes.loop.base_fit import BaseFit, refit_base
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.extend import ExtendedFit, extend
from aero_bayes.loop.found_effect import FoundEffect
from aero_bayes.loop.result import LoopOutcome
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.loop.steps import Step, equivalents, steps_of
from aero_bayes.search.explored import SearchResult
from aero_bayes.search.models import FittedModel

#: Largest number of equivalent alternatives that are listed by name.
MAX_NAMED_ALTERNATIVES = 2
#: Effective samples for each free parameter below which no effect can be found.
MIN_SAMPLES_PER_PARAMETER = 3.0


@dataclass(frozen=True, eq=False)
class Conclusion:
    """One way to end the loop.

    Parameters
    ----------
    base : BaseFit
        The first model at its best, its inputs read and its parameters freed as in the chosen structure.
    explored : SearchResult
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
    explored: SearchResult
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


def conclude(context: LoopContext, base: BaseFit, choice: Choice) -> Conclusion:
    """Name the structure that was chosen, unless unseen readings refuse it."""
    settings, explored, chosen = context.settings, choice.explored, choice.fitted
    within = settings.structures.equivalence
    base = refit_base(context, base, _first_of(explored, chosen))
    before = context.unseen.predict(base.plain, base.fit)
    context.statistics.end_stage("judgement")
    if not chosen.terms:
        return _without_effect(context, base, explored, choice, before)
    steps = steps_of(explored, chosen, within)
    try:
        extended = extend(context, base, explored, chosen)
    except CannotFinishError:
        why = f"{_explained(chosen)}, but with {_them(chosen)} the model cannot be simulated on unseen data."
        return _unexplained(base, explored, chosen, steps, why, before)
    if "Validation" not in settings.leave_out and not settings.structures.require:
        reason = refusal(before, extended.after, context.recordings, extended.reports)
        if reason:
            why = f"{_explained(chosen)}, but {reason} The missing effect is a different one."
            return _unexplained(base, explored, chosen, steps, why, before)
    sentence = _extended_text(context, explored, chosen, extended, before)
    return Conclusion(
        base, explored, chosen, steps, "extended", sentence, before, extended.after, extended.written,
        extended.effects, extended.calibration, extended.fit, extended.reports,
    )  # fmt: skip


def checks_of(settings: LoopSettings) -> list[Check]:
    """What a structure has to pass."""
    standard: tuple[Check, ...] = (
        EnoughReadings(),
        EnoughEvidence(),
        LeaveBlockOut(),
        LeftOver(settings.max_residual_share),
    )
    return [c for c in settings.checks or standard if type(c).__name__ not in settings.leave_out]


def _first_of(explored: SearchResult, chosen: FittedModel) -> FittedModel:
    """The first model, its inputs read and its parameters freed as in a structure."""
    return explored.fits.get(chosen.structure.minus(*chosen.terms), chosen)


def _without_effect(
    context: LoopContext, base: BaseFit, explored: SearchResult, choice: Choice, before: Prediction
) -> Conclusion:
    within = context.settings.structures.equivalence
    best = choice.refused[0][0] if choice.refused else choice.fitted
    steps = steps_of(explored, best, within)
    structured = structured_residuals(base.reports)
    last = steps[-1].why if steps else "no candidate was tried"
    far = far_off(
        context.unseen, base.plain, base.fit, base.reports, base.floors, before, context.settings.max_error_ratio
    )
    if not structured and not choice.refused:
        sentence = f"The model is adequate for these recordings: {last}."
        if far.beyond:
            sentence = (
                "The model fits the training data, but its error on unseen data is far larger: "
                f"{_ratios_text(far.beyond)}. The training data do not show the missing effect, or do not determine "
                "the parameters well enough."
            )
            return _unexplained(base, explored, choice.fitted, steps, sentence, before)
        if far.sensitive:
            sentence += (
                f" The error on unseen data is larger: {_ratios_text(far.sensitive)}. The uncertainty of the "
                "parameters explains this, because the unseen data are sensitive to them."
            )
        return Conclusion(
            base, explored, choice.fitted, steps, "adequate", sentence, before, before, None, (), base.plain, base.fit,
            base.reports,
        )  # fmt: skip
    sentence = _why_none(base, explored, choice, structured, last)
    return _unexplained(base, explored, choice.fitted, steps, sentence, before)


def _why_none(
    base: BaseFit, explored: SearchResult, choice: Choice, structured: Sequence[ResidualReport], last: str
) -> str:
    """Why a residual with structure gets no name."""
    moment = find_disturbance(base.reports)
    if moment is not None:
        recording, start, stop = moment
        return (
            f"Most of the residual of {recording} lies between {start:.3g} s and {stop:.3g} s. This is a single "
            "disturbance, so the model gets no new effect."
        )
    parameters, samples = len(explored.first_model.optimum.free), explored.noise.total_samples
    if samples < MIN_SAMPLES_PER_PARAMETER * parameters:
        return (
            f"The readings are correlated and count as {samples:.0f} independent ones. With {parameters} free "
            "parameters these are too few to find a missing effect."
        )
    if choice.refused:
        best, verdict = choice.refused[0]
        return f"{_explained(best)}, but {_they(best)} not accepted: {verdict.reason}."
    worst = max(structured, key=lambda r: r.ratio)
    return (
        f"The residual of {worst.output} is structured ({_ratio(worst.ratio)} times the noise floor{_nature(worst)}), "
        f"but no effect of the library explains it: {last}."
    )


def _unexplained(
    base: BaseFit,
    explored: SearchResult,
    chosen: FittedModel,
    steps: tuple[Step, ...],
    why: str,
    before: Prediction,
) -> Conclusion:
    return Conclusion(
        base, explored, chosen, steps, "unexplained", why, before, before, None, (), base.plain, base.fit,
        base.reports,
    )  # fmt: skip


def _explained(fitted: FittedModel) -> str:
    verb = "explain" if len(fitted.terms) > 1 else "explains"
    return f"The residual is structured. In the fitted data {join_names(list(fitted.terms))} {verb} part of it"


def _them(fitted: FittedModel) -> str:
    return "them" if len(fitted.terms) > 1 else "it"


def _they(fitted: FittedModel) -> str:
    return "they are" if len(fitted.terms) > 1 else "it is"


def _extended_text(
    context: LoopContext, explored: SearchResult, chosen: FittedModel, extended: ExtendedFit, before: Prediction
) -> str:
    required = context.settings.structures.require
    effects = sorted(extended.effects, key=lambda e: e.kind)  # what has a name first
    same = {t: equivalents(explored, chosen, t, context.settings.structures.equivalence) for t in chosen.terms}
    given, lacking = (
        [_effect_text(e, same[e.id]) for e in effects if (e.id in required) is asked] for asked in (True, False)
    )
    clauses = [f"was extended by {join_names(given)}, as required"] if given else []
    clauses += [f"lacks {join_names(lacking)}"] if lacking else []
    sentence = f"The model {', and '.join(clauses)}: {describe_error_change(before, extended.after, context.units)}"
    structured = structured_residuals(extended.reports)
    return sentence + (
        f" Structure remains in the residual of {', '.join(_structured_outputs(structured))}." if structured else ""
    )


def _effect_text(effect: FoundEffect, same: Sequence[str]) -> str:
    """An effect, and what it may be instead: the data cannot tell."""
    if effect.kind == "catalogue":
        others = [other for other in same if other != effect.id]
        if not others:
            return effect.id
        instead = " or ".join(others) if len(others) <= MAX_NAMED_ALTERNATIVES else f"one of {len(others)} others"
        return f"{effect.id} (or {instead}: the data cannot tell them apart)"
    return f"an effect at {effect.port} that no law of the library describes (learned as a curve over {effect.over})"


def _structured_outputs(structured: Sequence[ResidualReport]) -> list[str]:
    """Outputs with structure, with how far it is above the noise where it is far."""
    worst: dict[str, float] = {}
    for report in structured:
        worst[report.output] = max(report.ratio, worst.get(report.output, 0.0))
    return [
        f"{o} ({_ratio(worst[o])} times the noise floor)" if worst[o] > MAX_FLOOR_RATIO else o for o in sorted(worst)
    ]


def _ratio(ratio: float) -> str:
    return f"{ratio:.2g}" if ratio < 100.0 and math.isfinite(ratio) else "more than 100"


def _nature(report: ResidualReport) -> str:
    """How a residual near the noise floor differs from noise, by the test with the least p-value."""
    if report.ratio > MAX_FLOOR_RATIO or not report.tests:
        return ""
    clearest = min(report.tests, key=lambda t: t.p_value).name
    return {"autocorrelation": ", not white", "slow": ", drifting"}.get(clearest, f", correlated with {clearest}")


def _ratios_text(far: Mapping[tuple[str, str], float]) -> str:
    """Outputs with the worst of their ratios."""
    worst: dict[str, float] = {}
    for (_, output), ratio in far.items():
        worst[output] = max(ratio, worst.get(output, 0.0))
    return ", ".join(f"{output} ({ratio:.2g} times the error of the fit)" for output, ratio in worst.items())
