"""Make the result of a loop: plain values, and what was done in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from aero_bayes.arrays import FloatArray
from aero_bayes.design import FAMILIES, SearchSettings, separating_experiment
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel, calibrated_model
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.deciding_constants import name_deciding_constants
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.judge.prediction import shifts
from aero_bayes.judge.validation import LargeUnseenErrors, large_unseen_errors
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.decide import Decision
from aero_bayes.loop.extend import ExtendedFit, describe, fitted_parameters
from aero_bayes.loop.first_fit import FirstFit
from aero_bayes.loop.found_effect import NewParameter
from aero_bayes.loop.limits import limits_of
from aero_bayes.loop.result import LoopOutcome, LoopResult
from aero_bayes.loop.sentences import (
    early_end_sentence,
    extended_sentence,
    none_sentence,
    refused_sentence,
    sensitive_sentence,
    story_of,
)
from aero_bayes.loop.steps import steps_of
from aero_bayes.search.models import FittedModel
from aero_bayes.search.search import Search
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation.interface import DelayTarget, ParameterTarget
from aero_bayes.simulation.model import ModelicaSource

#: Search for a separating experiment within the loop: few signals, of few jumps; the command ``design`` tries more.
EXPERIMENT_SEARCH = SearchSettings(start=3, rounds=0, among=tuple(f for f in FAMILIES if f.jumps))


def result_of(
    context: LoopContext,
    first: FirstFit,
    search: Search,
    decision: Decision,
    extended: ExtendedFit | None,
    cause: DiagnosisRow | None,
) -> LoopResult:
    """Return all that the loop found, as plain values."""
    table, written = search.table, extended.written if extended is not None else None
    after = extended.fit if extended is not None else first.fit
    effects = extended.effects if extended is not None else ()
    predicted = context.unseen.predict(first.plain, first.fit.optimum)
    steps = steps_of(table, decision, search.library.required)
    same = tuple((t, *(o for o, _ in c.alternatives)) for t, c in decision.claims.items() if c.alternatives)
    fitted = fitted_parameters(after.calibration.parameters, after.optimum)
    outcome, sentence = _outcome(context, first, search, decision, extended)
    sentence += early_end_sentence(context, search.ended)
    data = next((row for row in first.fit.diagnosis if row.cause == "data" and row.found), None)
    if cause is not None:
        sentence = f"{cause.cause.capitalize()}: {cause.sentence} No missing effect was looked for in what this leaves."
    elif data is not None:
        sentence += f" Data: {data.sentence}"
    rivals = {r.id for step in steps for r in step.candidates}
    found, optimum = context.statistics.outcomes, first.fit.optimum
    context.statistics.end_stage("judgement")
    return LoopResult(
        outcome=outcome,
        sentence=sentence,
        base=context.family.base,
        model=written.name if written is not None else context.family.base,
        effects=effects,
        equivalent=same,
        limits=limits_of(search.screened.get(decision.model, {})),
        refused=decision.refused,
        before=first.fit,
        after=after,
        predicted_before=predicted,
        predicted_after=extended.after if extended is not None else predicted,
        floors=first.floors,
        residual_before=first.reports,
        residual_after=extended.reports if extended is not None else first.reports,
        steps=steps,
        shifts=shifts(first.plain.parameters, optimum, after.calibration.parameters, after.optimum) if effects else (),
        parameters=fitted,
        identifiability=name_deciding_constants(after.identifiability, after.calibration, after.optimum, context.open),
        noise=after.noise,
        modelica=written.text if written is not None else "",
        modelica_path=written.path.name if written is not None else "",
        diff=written.diff if written is not None else "",
        separate=_separating_experiments(context, search, decision, same),
        story=story_of(context, first, search, steps, effects, sentence),
        simulations=found.total(),
        failures=sum(count for how, count in found.items() if how),
        seconds=dict(context.statistics.seconds),
        words={id_: describe(context, id_) for id_ in sorted(rivals)},
        added=extended.added if extended is not None else (),
        diagnosis=first.fit.diagnosis,
        interpolation=after.calibration.data.interpolation,
        recordings=context.recordings,
        plain=context.family.base_model(),
        calibrated=_calibrated(context.family.base_model().source, extended, after, fitted),
        table=table,
        blocks=table.blocks,
    )


def _outcome(
    context: LoopContext, first: FirstFit, search: Search, decision: Decision, extended: ExtendedFit | None
) -> tuple[LoopOutcome, str]:
    """How the loop ended, and why."""
    before = context.unseen.predict(first.plain, first.fit.optimum)
    if extended is not None:
        return "extended", extended_sentence(context, extended, before, decision)
    structured = search.structured(decision.model)
    far = LargeUnseenErrors({}, {})
    if not structured:
        far = large_unseen_errors(
            context.unseen, first.plain, first.fit.optimum, first.reports, first.floors, before,
            context.settings.max_error_ratio,
        )  # fmt: skip
    steps = steps_of(search.table, decision, search.library.required)
    sentence = none_sentence(first, decision, structured, steps, far.unexplained)
    if structured or far.unexplained:
        return "unexplained", sentence + ("" if structured else refused_sentence(decision))
    return "adequate", sentence + sensitive_sentence(far.sensitive)


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


@dataclass(frozen=True, eq=False)
class _FittedAlternative:
    """A fitted model with only its free parameters, as the design of an experiment needs it."""

    calibration: Calibration
    values: FloatArray
    free: tuple[int, ...]
    noise: Mapping[str, OutputNoise]
    covariance: FloatArray

    @classmethod
    def of(cls, fitted: FittedModel) -> _FittedAlternative:
        fit, calibration = fitted.optimum, fitted.model.objective.calibration
        items, values = calibration.parameters.items, calibration.parameters.from_search(fit.coordinates)
        columns, targets = list(fit.free), [(j, p.target) for j, p in enumerate(items) if j not in fit.free]
        fixed_at = {t.name: float(values[j]) for j, t in targets if isinstance(t, ParameterTarget)}
        own = replace(calibration, parameters=ParameterSet(tuple(items[j] for j in columns)))
        return cls(own.with_fixed(fixed_at), values[columns], tuple(range(len(columns))), fit.noise, fit.covariance)


def _separating_experiments(
    context: LoopContext, search: Search, decision: Decision, classes: Sequence[Sequence[str]]
) -> tuple[str, ...]:
    """For the first class of equivalent terms: the experiments that would separate them, on a rig that is known."""
    if not classes or context.family.base_model().declared.limits.input is None:
        return ()
    (first, *others), fits, lines = classes[0], search.fits, list[str]()
    chosen = fits.get(decision.model)
    for other in others[:2]:
        rival = fits.get(tuple(sorted({*decision.model, other} - {first})))
        pair = f"{first} from {other}"
        if chosen is None or rival is None:
            continue
        try:
            apart = separating_experiment(
                _FittedAlternative.of(chosen), _FittedAlternative.of(rival), workers=context.pool.size,
                settings=replace(EXPERIMENT_SEARCH, seed=context.seed),
            )  # fmt: skip
        except (InputError, CannotFinishError):
            continue
        if apart.log_evidence < 1.0:
            lines.append(f"No experiment that was tried would tell {pair}.")
        else:
            lines.append(
                f"An experiment to tell {pair}: {apart.in_words} (expected difference in log-evidence "
                f"{apart.log_evidence:.0f}); `aero-bayes design --loop` writes the signal."
            )
    return tuple(lines)
