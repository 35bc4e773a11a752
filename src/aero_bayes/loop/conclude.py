"""What the loop concludes: an outcome, the model behind it with its fit, and the sentences that say why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from aero_bayes.check.residual_tests import MAX_FLOOR_RATIO, ResidualReport, structured_residuals
from aero_bayes.display import join_names
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.result import Fit
from aero_bayes.judge.choice import Choice
from aero_bayes.judge.disturbance import find_disturbance
from aero_bayes.judge.prediction import Prediction, describe_error_change
from aero_bayes.judge.validation import large_unseen_errors, rejection_reason
from aero_bayes.laws.model_family import ExtendedModel
from aero_bayes.loop.base_fit import BaseFit, refit_base
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.extend import ExtendedFit, extend, smaller_effects
from aero_bayes.loop.found_effect import FoundEffect
from aero_bayes.loop.ranking import Step, steps_of
from aero_bayes.loop.result import LoopOutcome
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.search.comparison import Share
from aero_bayes.search.models import FittedModel

#: Largest number of equivalent alternatives that are listed by name.
MAX_NAMED_ALTERNATIVES = 2
#: What may be behind it when unseen data refuse what explains the fitted ones.
REFUSED_BY_UNSEEN = "Another effect is missing, or a further one that shows only on the unseen data."
#: Structures that unseen readings may refuse before nothing is named, besides parts of the first one, which claim less:
#: with more of them one would pass by chance.
MAX_REFUSALS = 3


@dataclass(frozen=True, eq=False)
class Conclusion:
    """One way to end the loop."""

    base: BaseFit
    choice: Choice
    steps: tuple[Step, ...]
    outcome: LoopOutcome
    sentence: str
    before: Prediction
    after: Prediction
    written: ExtendedModel | None
    effects: tuple[FoundEffect, ...]
    smaller: tuple[FoundEffect, ...]
    calibration: Calibration
    refit: Optimum
    reports: tuple[ResidualReport, ...]
    found: Fit


def other_cause(base: BaseFit, settings: LoopSettings) -> DiagnosisRow | None:
    """Name the cause beside the model that may explain what is left, so that no missing effect is looked for."""
    return None if settings.structures.require else base.diagnosis.explanation


def diagnosed(conclusion: Conclusion, base: BaseFit, settings: LoopSettings) -> Conclusion:
    """Return the conclusion with the other cause as its sentence, and with what was mended of the data."""
    cause = other_cause(base, settings)
    if cause is not None:
        sentence = f"{cause.cause.capitalize()}: {cause.sentence} No missing effect was looked for in what this leaves."
        return replace(conclusion, sentence=sentence)
    data = next((row for row in base.diagnosis if row.cause == "data" and row.found), None)
    return conclusion if data is None else replace(conclusion, sentence=f"{conclusion.sentence} Data: {data.sentence}")


def conclude(context: LoopContext, base: BaseFit, choice: Choice) -> Conclusion:
    """Name the structure that was chosen, unless unseen readings refuse it; then the next one that they do not."""
    offered: Choice | None = choice
    refused: dict[tuple[str, ...], Conclusion] = {}
    while offered is not None and sum(not set(terms) < set(choice.terms) for terms in refused) < MAX_REFUSALS:
        told = offered.told()
        # Where what is told is a part only, and refused, another structure may be told as a whole.
        for one in (told, *(offered.told_whole() if len(told.terms) < len(offered.terms) else ())):
            if one.terms not in refused:
                conclusion, accepted = _offer(context, base, one)
                if accepted:
                    return conclusion
                refused[one.terms] = conclusion
        offered = offered.refuse()
    return next(iter(refused.values()))


def _offer(context: LoopContext, base: BaseFit, choice: Choice) -> tuple[Conclusion, bool]:
    """Return the conclusion from a choice, and whether unseen readings accept it."""
    settings, chosen = context.settings, choice.fitted
    base = refit_base(context, base, _first_of(choice))
    before = context.unseen.predict(base.plain, base.fit)
    context.statistics.end_stage("judgement")
    smaller = smaller_effects(context, choice)
    if not (chosen.terms or (settings.include_smaller and smaller)):
        return _without_effect(context, base, choice, before, smaller), True
    try:
        extended = extend(context, base, choice)
    except CannotFinishError:
        why = f"{_explained(chosen)}, but with {_them(chosen)} the model cannot be simulated on unseen data."
        return _unexplained(base, choice, why, before, smaller), False
    if "Validation" not in settings.leave_out and not settings.structures.require:
        reason = rejection_reason(before, extended.after, context.recordings, extended.reports)
        if reason:
            why = f"{_explained(chosen)}, but {reason} {REFUSED_BY_UNSEEN}"
            return _unexplained(base, choice, why, before, smaller), False
        fewer = _without_needless_term(context, base, choice, extended)
        if fewer is not None:
            return _offer(context, base, fewer)
    return Conclusion(
        base, choice, steps_of(choice), "extended", _extended_text(context, choice, extended, before), before,
        extended.after, extended.written, extended.effects, extended.smaller or smaller, extended.calibration,
        extended.fit, extended.reports, extended.found,
    ), True  # fmt: skip


def _without_needless_term(context: LoopContext, base: BaseFit, choice: Choice, extended: ExtendedFit) -> Choice | None:
    """Return the choice without a term that the last fit or unseen readings refuse beside the others.

    None where all hold."""
    if len(choice.terms) < 2 or extended.smaller:
        return None
    for id_ in reversed(choice.terms):
        part = choice.structure.minus(id_)
        if part not in choice.explored.fits or part not in choice.comparison.squares:
            continue
        fewer = choice.at(part)
        with suppress(CannotFinishError):
            less = extend(context, base, fewer)
            if rejection_reason(less.after, extended.after, context.recordings, extended.reports):
                return fewer
    return None


def _first_of(choice: Choice) -> FittedModel:
    """Return the first model, its inputs read and its parameters freed as in the chosen structure."""
    return choice.explored.fits.get(choice.structure.minus(*choice.structure.terms), choice.fitted)


def _without_effect(
    context: LoopContext, base: BaseFit, choice: Choice, before: Prediction, smaller: tuple[FoundEffect, ...]
) -> Conclusion:
    steps, structured = steps_of(choice), structured_residuals(base.reports)
    far = large_unseen_errors(
        context.unseen, base.plain, base.fit, base.reports, base.floors, before, context.settings.max_error_ratio
    )
    if structured or choice.unsure or choice.undecided:
        return _unexplained(base, choice, _why_none(base, choice, structured), before, smaller)
    sentence = f"The model is adequate for these recordings: {steps[-1].why}."
    if far.unexplained:
        sentence = (
            "The model fits the training data, but its error on unseen data is far larger: "
            f"{_ratios_text(far.unexplained)}. The training data do not show the missing effect, or do not determine "
            "the parameters well enough."
        )
        return _unexplained(base, choice, sentence, before, smaller)
    if far.sensitive:
        sentence += (
            f" The error on unseen data is larger: {_ratios_text(far.sensitive)}. The uncertainty of the "
            "parameters explains this, because the unseen data are sensitive to them."
        )
    return Conclusion(
        base, choice, steps, "adequate", sentence, before, before, None, (), smaller, base.plain, base.fit,
        base.reports, base.found,
    )  # fmt: skip


def _why_none(base: BaseFit, choice: Choice, structured: Sequence[ResidualReport]) -> str:
    """Why a residual with structure gets no name."""
    moment = find_disturbance(base.reports)
    if moment is not None:
        recording, start, stop = moment
        return (
            f"Most of the residual of {recording} lies between {start:.3g} s and {stop:.3g} s. This is a single "
            "disturbance, so the model gets no new effect."
        )
    if choice.undecided:
        return (
            f"The data do not tell what is missing: {_one_of(choice.undecided)}. Each lowers the error on left-out "
            "readings about as well as the others."
        )
    unsure = choice.unsure
    if unsure:
        share = choice.comparison.share(unsure, choice.structure)
        return (
            f"The readings are too few to name an effect: with {join_names(unsure.terms)} the error of "
            f"{share.output} on left-out readings {share.fall}, and that is not clear over "
            f"{choice.comparison.blocks} blocks."
        )
    worst = max(structured, key=lambda r: r.ratio)
    size = f"{_ratio(worst.ratio)} times the noise floor{_nature(worst)}"
    left = f"The residual of {worst.output} is structured ({size})"
    return f"{left}, but no effect of the library is material: {steps_of(choice)[-1].why}."


def _unexplained(
    base: BaseFit, choice: Choice, why: str, before: Prediction, smaller: tuple[FoundEffect, ...]
) -> Conclusion:
    return Conclusion(
        base, choice, steps_of(choice), "unexplained", why, before, before, None, (), smaller, base.plain, base.fit,
        base.reports, base.found,
    )  # fmt: skip


def _one_of(ids: Sequence[str]) -> str:
    """Some terms, the last ones counted where they are many."""
    named, more = list(ids[: MAX_NAMED_ALTERNATIVES + 1]), len(ids) - MAX_NAMED_ALTERNATIVES - 1
    return " or ".join([*named, f"one of {more} others"] if more > 1 else ids)


def _explained(fitted: FittedModel) -> str:
    verb = "explain" if len(fitted.terms) > 1 else "explains"
    return f"The residual is structured. In the fitted data {join_names(list(fitted.terms))} {verb} part of it"


def _them(fitted: FittedModel) -> str:
    return "them" if len(fitted.terms) > 1 else "it"


def _extended_text(context: LoopContext, choice: Choice, extended: ExtendedFit, before: Prediction) -> str:
    required = context.settings.structures.require
    effects = sorted(extended.effects, key=lambda e: e.kind)  # what has a name first
    given, lacking = (
        [_effect_text(e, choice.alike(e.id)) for e in effects if (e.id in required) is asked] for asked in (True, False)
    )
    clauses = [f"was extended by {join_names(given)}, as required"] if given else []
    clauses += [f"lacks {join_names(lacking)}"] if lacking else []
    if not clauses:
        clauses = [f"was extended by small effects, {join_names([e.id for e in extended.smaller])}"]
    asked = [e for e in effects if e.id not in required]
    begin = " With {} the error of" if len(asked) > 1 else " The error of"
    falls = [
        f"{begin.format(e.id)} {e.share_of} on left-out readings {Share(e.share, e.share_sd, e.share_of).fall}."
        for e in asked
    ]
    if choice.undecided:
        what = f"perhaps {choice.undecided[0]}" if len(choice.undecided) == 1 else _one_of(choice.undecided)
        falls.append(f" What else is missing, the data do not tell: {what}.")
    sentence = f"The model {', and '.join(clauses)}: {describe_error_change(before, extended.after, context.units)}"
    structured = structured_residuals(extended.reports)
    return (
        sentence
        + "".join(falls)
        + (f" Structure remains in the residual of {', '.join(_structured_outputs(structured))}." if structured else "")
    )


def _effect_text(effect: FoundEffect, same: Sequence[str]) -> str:
    """Return an effect, and what it may be instead: the data cannot tell."""
    others = [other for other in same if other != effect.id]
    instead = " or ".join(others) if len(others) <= MAX_NAMED_ALTERNATIVES else f"one of {len(others)} others"
    if effect.kind == "catalogue":
        return effect.id + (f" (or {instead}: the data cannot tell them apart)" if others else "")
    like = f", it looks like {effect.looks_like}" if effect.looks_like else ""
    return (
        f"an effect at {effect.port} that no law of the library describes (learned as a curve over {effect.over}{like}"
        + (f"; or {instead}: the data cannot tell them apart)" if others else ")")
    )


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
    """Return how a residual near the noise floor differs from noise, by the test with the least p-value."""
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
