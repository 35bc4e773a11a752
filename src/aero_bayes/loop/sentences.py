"""Make the result of a loop: plain values, and what was done in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from aero_bayes.display import join_names, with_unit
from aero_bayes.estimate.calibrated_model import CalibratedModel, calibrated_model
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.residual_tests import ResidualReport, structured_residuals
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.decide import Decision
from aero_bayes.loop.extend import ExtendedFit, FoundEffect, NewParameter, describe, fitted_parameters, limits_of
from aero_bayes.loop.first_fit import FirstFit, LoopContext, LoopSettings
from aero_bayes.loop.result import LoopOutcome, LoopResult, Step, fall, steps_of
from aero_bayes.loop.search import Search
from aero_bayes.loop.unseen import Prediction, describe_error_change, shifts
from aero_bayes.simulation.interface import DelayTarget
from aero_bayes.simulation.model import ModelicaSource

#: Alternatives that are listed by name.
MAX_NAMED = 3
#: Share of the squared residual in a tenth of a recording from which it is one disturbance.
DISTURBANCE_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class Ended:
    """How a loop ended: the first fit, the search, what was decided on it, and the fit of the extended model."""

    first: FirstFit
    search: Search
    decision: Decision
    extended: ExtendedFit | None

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        return steps_of(self.search.table, self.decision, self.search.library.required)


def extended_sentence(context: LoopContext, ended: Ended, before: Prediction) -> str:
    """The model, the error before and after, and what is claimed of each term."""
    extended = ended.extended
    assert extended is not None
    effects = sorted(extended.effects, key=lambda e: e.kind)  # what has a name first
    change = describe_error_change(before, extended.after, context.units)
    known = all(e.claim == "law" for e in effects)
    text = f"The model {'lacks' if known else 'was extended by'} {join_names([e.id for e in effects])}: {change}"
    text += "".join(f" {_claim_sentence(e)}" for e in effects)
    text += refused_sentence(ended.decision)
    left = structured_residuals(extended.reports)
    return text + (
        f" Structure remains in the residual of {join_names(sorted({r.output for r in left}))}." if left else ""
    )


def refused_sentence(decision: Decision) -> str:
    """How many models unseen recordings refused; empty for none."""
    count = len(decision.refused)
    return f" Unseen recordings refused {count} model{'s' * (count > 1)} before it." if count else ""


def _claim_sentence(effect: FoundEffect) -> str:
    """What is claimed of a term."""
    if effect.claim is None:
        return f"{effect.id} is there as required."
    others = [one.id for one in effect.alternatives]
    named = join_names(others if len(others) <= MAX_NAMED else [*others[:MAX_NAMED], f"{len(others) - MAX_NAMED} more"])
    text = f"With {effect.id} the error of {effect.share_of} on left-out readings {fall(effect.share, effect.share_sd)}"
    if not others or effect.claim == "law":
        like = f", which looks like {effect.looks_like}" if effect.looks_like else ""
        no_law = f", but no law says what this curve is{like}" if effect.kind == "free_form" else ""
        return f"{text}; nothing else that was tried does as well{no_law}."
    told = {
        "place": "at the same place, so that the place is known and not the law",
        "one of": "so that the data do not tell which it is",
    }
    does = "do" if len(others) > 1 else "does"
    return f"{text}; {named} {does} as well{', ' if effect.claim == 'one of' else ' '}{told[effect.claim]}."


def none_sentence(ended: Ended, structured: Sequence[str], far: Mapping[str, float]) -> str:
    """Why nothing was added."""
    if far:
        ratios = ", ".join(f"{output} ({ratio:.2g} times the error of the fit)" for output, ratio in far.items())
        return (
            f"The model fits the training data, but its error on unseen data is far larger: {ratios}. The training "
            "data do not show the missing effect, or do not determine the parameters well enough."
        )
    if not structured:
        return "The model is adequate for these recordings: it leaves no more than what the sensors add."
    first, decision, steps = ended.first, ended.decision, ended.steps
    reports = [r for r in first.reports if r.output in structured]
    moment = _disturbance(reports)
    if moment is not None and not decision.refused:
        recording, start, stop = moment
        return (
            f"Most of the residual of {recording} lies between {start:.3g} s and {stop:.3g} s. This is a single "
            "disturbance, so the model gets no new effect."
        )
    worst = max(reports, key=lambda r: r.ratio)
    far_above = "more than 100" if worst.ratio >= 100.0 else f"{worst.ratio:.2g}"
    text = f"The residual of {worst.output} is structured ({far_above} times the noise floor)"
    if decision.refused:
        return f"{text}, but unseen recordings refuse all {len(decision.refused)} models that explain a part of it."
    return f"{text}, but no effect that was tried is material" + (f": {steps[-1].why}." if steps else ".")


def early_end_sentence(context: LoopContext, where: str) -> str:
    """Where the time limit or an interrupt ended the search; empty where the search was completed."""
    if not where:
        return ""
    limit = f"reached its time limit of {context.settings.max_minutes:g} min"
    ended = "was interrupted" if context.statistics.watched.asked_to_end else limit
    return f" The search {ended} at {where}, so it may have missed effects."


def story_of(context: LoopContext, ended: Ended, told: str) -> tuple[str, ...]:
    """What was done, in sentences."""
    first, search, steps = ended.first, ended.search, ended.steps
    effects = ended.extended.effects if ended.extended is not None else ()
    worst = max(first.reports, key=lambda r: r.ratio)
    refits = sum(row.refitted for row in search.table.rows.values())
    lines = [
        f"{context.family.title} was fitted as given. Its residual of {worst.output} in {worst.recording} is "
        f"{worst.ratio:.2g} times the noise floor and {worst.verdict}.",
        _data_sentence(context),
        *_restrictions(context.settings),
        f"{len(search.fits)} model structures were compared by their error on readings that were left out, in "
        f"{search.table.blocks} blocks; {refits} of them were fitted again without each block.",
        *(f"Step {s.number}: {s.why}." for s in steps),
    ]
    if search.skipped:
        lines.append(f"Not tried, because the model with them cannot be simulated: {', '.join(search.skipped)}.")
    for effect in effects:
        values = ", ".join(with_unit(f"{p.name} = {p.value:.3g}", p.unit) for p in effect.parameters)
        lines.append(f"Added at port {effect.port}: {effect.id}, with {values}.")
    return (*lines, told)


def _restrictions(settings: LoopSettings) -> tuple[str, ...]:
    """What the configuration allows and excludes."""
    only = [*(settings.effects or ()), *(settings.laws or ())]
    lines = [f"The configuration allows only {', '.join(only)}."] if only else []
    lines += [f"The configuration allows effects only at {', '.join(settings.ports)}."] if settings.ports else []
    lines += [f"The configuration excludes {', '.join(settings.exclude)}."] if settings.exclude else []
    return tuple(lines)


def _data_sentence(context: LoopContext) -> str:
    """Which readings were fitted and which were used for the test."""
    recordings = context.recordings
    fitted = join_names([r.name for r in recordings.train])
    if recordings.unseen_from:
        ends = ", ".join(f"{name} from {time:.3g} s" for name, time in recordings.unseen_from.items())
        return f"Fit and search used the first part of {fitted}. The rest ({ends}) could only refuse a model."
    unseen = join_names([r.name for r in recordings.test])
    return f"Recordings for fit and search: {fitted}. Recordings that could only refuse a model: {unseen}."


def _disturbance(reports: Sequence[ResidualReport]) -> tuple[str, float, float] | None:
    """Recording, start and end in s of a disturbance: a tenth of the recording has most of the squared residual."""
    found = [r for r in structured_residuals(reports) if r.worst_share > DISTURBANCE_SHARE and math.isfinite(r.ratio)]
    worst = max(found, key=lambda r: r.worst_share, default=None)
    return None if worst is None else (worst.recording, *worst.worst_time)


def result_of(context: LoopContext, ended: Ended, cause: DiagnosisRow | None) -> LoopResult:
    """Return all that the loop found, as plain values."""
    first, search, decision, extended = ended.first, ended.search, ended.decision, ended.extended
    table, written = search.table, extended.written if extended is not None else None
    after = extended.fit if extended is not None else first.fit
    effects = extended.effects if extended is not None else ()
    predicted = context.unseen.predict(first.plain, first.fit.optimum)
    same = tuple((t, *(o for o, _ in c.alternatives)) for t, c in decision.claims.items() if c.alternatives)
    fitted = fitted_parameters(after.calibration.parameters, after.optimum)
    steps, (outcome, sentence) = ended.steps, _outcome(context, ended, predicted)
    early = early_end_sentence(context, search.ended)
    sentence += early
    data = next((row for row in first.fit.diagnosis if row.cause == "data" and row.found), None)
    if cause is not None:
        sentence = f"{cause.cause.capitalize()}: {cause.sentence} No missing effect was looked for in what this leaves."
    elif data is not None:
        sentence += f" Data: {data.sentence}"
    notes = tuple(filter(None, map(str.strip, (refused_sentence(decision), early))))
    rivals = {r.id for step in steps for r in step.candidates}
    found, optimum = context.statistics.outcomes, first.fit.optimum
    context.statistics.end_stage("judgement")
    return LoopResult(
        outcome=outcome, sentence=sentence, base=context.family.base,
        model=written.name if written is not None else context.family.base, effects=effects, equivalent=same,
        limits=limits_of(search, decision.model), refused=decision.refused, before=first.fit, after=after,
        predicted_before=predicted, predicted_after=extended.after if extended is not None else predicted,
        floors=first.floors, residual_before=first.reports,
        residual_after=extended.reports if extended is not None else first.reports, steps=steps,
        shifts=shifts(first.plain.parameters, optimum, after.calibration.parameters, after.optimum) if effects else (),
        parameters=fitted,
        identifiability=after.identifiability,
        noise=after.noise, modelica=written.text if written is not None else "",
        modelica_path=written.path.name if written is not None else "",
        diff=written.diff if written is not None else "", separate=_separate(decision),
        story=story_of(context, ended, sentence), simulations=found.total(),
        failures=sum(count for how, count in found.items() if how), seconds=dict(context.statistics.seconds),
        words={id_: describe(context, id_) for id_ in sorted(rivals)},
        added=extended.added if extended is not None else (), diagnosis=first.fit.diagnosis,
        interpolation=after.calibration.data.interpolation, recordings=context.recordings,
        plain=context.family.base_model(),
        calibrated=_calibrated(context.family.base_model().source, extended, after, fitted), table=table,
        blocks=table.blocks,
        data_notes=notes if effects else (),
    )  # fmt: skip


def _outcome(context: LoopContext, ended: Ended, before: Prediction) -> tuple[LoopOutcome, str]:
    """How the loop ended, and why."""
    if ended.extended is not None:
        return "extended", extended_sentence(context, ended, before)
    structured = ended.search.structured(ended.decision.model)
    far = {} if structured else _far_off(context, ended.first, before)
    return "unexplained" if structured or far else "adequate", none_sentence(ended, structured, far)


def _calibrated(
    source: ModelicaSource | None, extended: ExtendedFit | None, after: Fit, fitted: Mapping[str, NewParameter]
) -> CalibratedModel | None:
    """The model that came out with all its values; none where it came as an FMU."""
    if source is None:
        return None
    written = extended.written if extended is not None else None
    calibration = after.calibration
    values = calibration.parameters.from_search(after.optimum.coordinates)
    name, added = (source.name, {}) if written is None else (written.name, {written.path.name: written.text})
    new = extended.added if extended is not None else ()
    delays = [p.name for p in new if isinstance(p.target, DelayTarget)]
    return calibrated_model(calibration, values, fitted, source=replace(source, name=name), added=added, delays=delays)


def _far_off(context: LoopContext, first: FirstFit, before: Prediction) -> dict[str, float]:
    """Errors on unseen data over what an adequate fit leaves, by output, where they are far larger."""
    left = {(r.recording, r.output): r.rms for r in first.reports}
    far: dict[str, float] = {}
    for (name, output), error in before.test.items():
        own = [rms for (_, other), rms in left.items() if other == output]
        ratio = error.rms / max([first.fit.noise[output].sd, first.floors.get((name, output), 0.0), *own])
        if ratio > max(context.settings.max_error_ratio, far.get(output, 0.0)):
            far[output] = ratio
    return far


def _separate(decision: Decision) -> tuple[str, ...]:
    """How to find an experiment that tells effects apart."""
    return tuple(
        f"`aero-bayes design --separate {term} {claim.alternatives[0][0]}` proposes what would tell them apart."
        for term, claim in decision.claims.items()
        if claim.alternatives and claim.kind != "law"
    )
