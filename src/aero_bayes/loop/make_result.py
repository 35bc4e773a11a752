"""Make the result of a loop: plain values, and what was done in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from aero_bayes.estimate.calibrated_model import CalibratedModel, calibrated_model
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.result import Fit
from aero_bayes.judge.prediction import Prediction, shifts
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.decide import Decision
from aero_bayes.loop.extend import ExtendedFit, describe, fitted_parameters
from aero_bayes.loop.first_fit import FirstFit
from aero_bayes.loop.found_effect import NewParameter, limits_of
from aero_bayes.loop.result import LoopOutcome, LoopResult
from aero_bayes.loop.sentences import (
    Ended,
    early_end_sentence,
    extended_sentence,
    none_sentence,
    refused_sentence,
    story_of,
)
from aero_bayes.simulation.interface import DelayTarget
from aero_bayes.simulation.model import ModelicaSource


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
