"""Make the result of a loop: plain values, why it ended so, and what was done."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from aero_bayes.estimate.calibrated_model import CalibratedModel, calibrated_model
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.error_sentences import left_over
from aero_bayes.estimate.predict_recordings import Prediction
from aero_bayes.estimate.residual_tests import RecordingError, ResidualReport, recording_errors, structured_residuals
from aero_bayes.loop.decide import Decision
from aero_bayes.loop.extend import ExtendedFit, limits_of
from aero_bayes.loop.first_fit import FirstFit, LoopContext, LoopSettings
from aero_bayes.loop.result import LoopOutcome, LoopResult, Step, free_estimates, steps_of
from aero_bayes.loop.search import Search
from aero_bayes.loop.sentences import extended_sentence
from aero_bayes.simulation.interface import DelayTarget
from aero_bayes.simulation.model import ModelicaSource

#: Models that are named of those that validation readings speak against.
MOST_REFUSED_NAMED = 5
#: Share of the squared residual in a tenth of a recording from which it is one disturbance.
DISTURBANCE_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class Ended:
    """How a loop ended: the first fit, its prediction, the search, what was decided on it, and the final fit."""

    first: FirstFit
    predicted: Prediction
    search: Search
    decision: Decision
    final: ExtendedFit

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        return steps_of(self.search.table, self.decision, self.search.library.required)


def refused_sentence(decision: Decision) -> str:
    """Which structures explain more in training and less in validation; empty for none."""
    count = len(decision.refused)
    if not count:
        return ""
    named = "; ".join(" and ".join(k) for k in decision.refused[:MOST_REFUSED_NAMED])
    more = f"; {count - MOST_REFUSED_NAMED} more" if count > MOST_REFUSED_NAMED else ""
    models, explain, predict = ("model", "explains", "predicts") if count == 1 else ("models", "explain", "predict")
    return (
        f"{count} {models} {explain} the training recordings better and {predict} the validation readings worse: "
        f"{named}{more}."
    )


def none_sentence(ended: Ended, structured: Sequence[str], far: bool, left: bool) -> str:
    """Why nothing was added; ``left`` where a recording is not explained down to the noise."""
    if far:
        return (
            "The model fits the training data, but not data that was not fitted. The training data do not show the "
            "missing effect, or do not determine the parameters well enough."
        )
    if not structured:
        adequate = "The model is adequate for these recordings: it leaves no more than what the sensors add."
        return "No missing effect was found." if left else adequate
    decision, steps = ended.decision, ended.steps
    moment = _disturbance([r for r in ended.first.reports if r.output in structured])
    if moment is not None and not decision.refused:
        recording, start, stop = moment
        return (
            f"Most of the residual of {recording} lies between {start:.3g} s and {stop:.3g} s. This is a single "
            "disturbance, so the model gets no new effect."
        )
    text = "What the model leaves has structure"
    if decision.refused:
        return f"{text}, but no model that explains a part of it is confirmed by the validation readings."
    return f"{text}, but no effect that was tried is material" + (f": {steps[-1].why}." if steps else ".")


def early_end_sentence(context: LoopContext, where: str) -> str:
    """Where the time limit or an interrupt ended the search; empty where the search was completed."""
    if not where:
        return ""
    limit = f"reached its time limit of {context.settings.max_minutes:g} min"
    ended = "was interrupted" if context.statistics.watched.asked_to_end else limit
    return f"The search {ended} at {where}, so it may have missed effects."


def story_of(context: LoopContext, ended: Ended) -> tuple[str, ...]:
    """What was done, in sentences; the steps of the search have entries of their own."""
    first, search = ended.first, ended.search
    worst = max(first.reports, key=lambda r: r.over_noise)
    known = f"{worst.over_noise:.2g} times the noise floor and {worst.verdict}"
    left = known if worst.noise_floor is not None else f"{worst.verdict}; its noise floor is not known"
    refits = sum(row.refitted for row in search.table.rows.values())
    lines = [
        f"{context.family.places.title} was fitted as given. Its residual of {worst.output} in {worst.recording} is "
        f"{left}.",
        context.recordings.sentence,
        *_restrictions(context.settings),
        f"{len(search.fits)} model structures were compared by two errors: on training readings that were left out, "
        f"in {len(search.folds.blocks)} folds, and on validation readings; {refits} of them were fitted again without "
        "each fold.",
    ]
    lines += [told] if (told := refused_sentence(ended.decision)) else []
    if search.skipped:
        lines.append(f"Not tried, because the model with them cannot be simulated: {', '.join(search.skipped)}.")
    return tuple(lines)


def _restrictions(settings: LoopSettings) -> tuple[str, ...]:
    """What the configuration allows and excludes."""
    only = [*(settings.effects or ()), *(settings.laws or ())]
    lines = [f"The configuration allows only {', '.join(only)}."] if only else []
    lines += [f"The configuration allows effects only at {', '.join(settings.ports)}."] if settings.ports else []
    lines += [f"The configuration excludes {', '.join(settings.exclude)}."] if settings.exclude else []
    return tuple(lines)


def _disturbance(reports: Sequence[ResidualReport]) -> tuple[str, float, float] | None:
    """Recording, start and end in s of a disturbance: a tenth of the recording has most of the squared residual."""
    found = [
        r for r in structured_residuals(reports) if r.worst_share > DISTURBANCE_SHARE and math.isfinite(r.over_noise)
    ]
    worst = max(found, key=lambda r: r.worst_share, default=None)
    if worst is None:
        return None
    start, end = worst.worst_time
    return worst.recording, start, end


def result_of(context: LoopContext, ended: Ended, cause: DiagnosisRow | None) -> LoopResult:
    """Return all that the loop found, and why it ended so."""
    first, search, final = ended.first, ended.search, ended.final
    after, predicted, recordings = final.fit, ended.predicted, context.recordings
    spreads = after.calibration.data.spreads
    errors = recording_errors(
        recordings.parts, predicted.fitted, final.after.fitted, first.floors, after.noise, spreads
    )
    outcome, sentence = _outcome(context, ended, errors)
    steps, notes = ended.steps, tuple(filter(None, (early_end_sentence(context, search.ended),)))
    data = next((row for row in after.diagnosis if row.cause == "data" and row.found), None)
    sentence = " ".join([sentence, *left_over(errors), *notes, *([f"Data: {data.sentence}"] if data else [])])
    if cause is not None:
        sentence = f"{cause.cause.capitalize()}: {cause.sentence} No missing effect was looked for in what this leaves."
    rivals = {r.id for step in steps for r in step.candidates}
    found = context.statistics.outcomes
    context.statistics.end_stage("judgement")
    return LoopResult(
        outcome=outcome, sentence=sentence, base=context.family.places.base, first=first, predicted_before=predicted,
        table=search.table, decision=ended.decision, final=final, limits=limits_of(search, ended.decision.model),
        steps=steps, errors=errors, story=story_of(context, ended),
        words={id_: context.family.describe(id_) for id_ in sorted(rivals)}, data_notes=notes, recordings=recordings,
        calibrated=_calibrated(context.family.base_model().source, final), simulations=found.total(),
        failures=sum(count for how, count in found.items() if how), seconds=dict(context.statistics.seconds),
    )  # fmt: skip


def _outcome(context: LoopContext, ended: Ended, errors: Sequence[RecordingError]) -> tuple[LoopOutcome, str]:
    """How the loop ended, and why."""
    if ended.final.effects:
        units = {v.name: v.unit for v in context.family.base_model().outputs}
        told = [extended_sentence(context.family.places.base, ended.final.effects, errors, units)]
        return "extended", " ".join([*told, *_restrictions(context.settings)])
    structured = ended.search.structured(ended.decision.model)
    far = not structured and _far_off(context, ended.first, ended.predicted)
    why = none_sentence(ended, structured, far, bool(left_over(errors)))
    return "unexplained" if structured or far else "adequate", why


def _calibrated(source: ModelicaSource | None, final: ExtendedFit) -> CalibratedModel | None:
    """The model that came out with all its values; none where it came as an FMU."""
    if source is None:
        return None
    written, calibration = final.written, final.fit.calibration
    values = calibration.parameters.from_search(final.fit.optimum.coordinates)
    name, added = (source.name, {}) if written is None else (written.name, {written.path.name: written.text})
    delays = [p.name for p in final.added if isinstance(p.target, DelayTarget)]
    return calibrated_model(
        calibration, values, free_estimates(final.fit), source=replace(source, name=name), added=added, delays=delays
    )


def _far_off(context: LoopContext, first: FirstFit, before: Prediction) -> bool:
    """Whether the error of an output on data that was not fitted is far larger than what an adequate fit leaves."""
    for (name, output), error in before.by_role(before.judged).items():
        own = [r.rms for r in first.reports if r.output == output]
        least = max([first.fit.noise[output].sd, first.floors.get((name, output), 0.0), *own])
        if error.rms > context.settings.max_error_ratio * least:
            return True
    return False
