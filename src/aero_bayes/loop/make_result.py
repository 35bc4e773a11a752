"""Make the result of a loop from its conclusion: plain values, and what was done in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from aero_bayes.arrays import FloatArray
from aero_bayes.design import FAMILIES, SearchSettings, separating_experiment
from aero_bayes.display import join_names, with_unit
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel, calibrated_model
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.finished_fit import assess_columns, with_bounds
from aero_bayes.estimate.identifiability import Identifiability
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.judge.prediction import shifts
from aero_bayes.loop.conclude import Conclusion
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.extend import fitted_parameters
from aero_bayes.loop.found_effect import NewParameter
from aero_bayes.loop.result import LoopResult
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.search.models import FittedModel
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation.interface import DelayTarget, ParameterTarget
from aero_bayes.simulation.model import ModelicaSource

#: Search for a separating experiment within the loop: few signals, of few jumps; the command ``design`` tries more.
EXPERIMENT_SEARCH = SearchSettings(start=3, rounds=0, among=tuple(f for f in FAMILIES if f.jumps))


def result_of(context: LoopContext, conclusion: Conclusion) -> LoopResult:
    """Return all that the loop found, as plain values."""
    base, written, effects = conclusion.base, conclusion.written, conclusion.effects
    same = _equivalent(conclusion)
    parameters = base.plain.parameters
    fitted = fitted_parameters(conclusion.calibration.parameters, conclusion.refit)
    moved = shifts(parameters, base.fit, conclusion.calibration.parameters, conclusion.refit) if effects else ()
    rivals = {r.id for step in conclusion.steps for r in step.candidates}
    sentence = conclusion.sentence + _early_end_sentence(context, conclusion.choice.explored.ended)
    return LoopResult(
        outcome=conclusion.outcome,
        sentence=sentence,
        base=context.family.base,
        model=written.name if written is not None else context.family.base,
        effects=effects,
        smaller=conclusion.smaller,
        equivalent=same,
        before=base.found,
        after=conclusion.found,
        predicted_before=conclusion.before,
        predicted_after=conclusion.after,
        floors=base.floors,
        residual_before=base.reports,
        residual_after=conclusion.reports,
        steps=conclusion.steps,
        shifts=moved,
        parameters=fitted,
        identifiability=_identifiability(context, conclusion.calibration, conclusion.refit),
        noise=conclusion.refit.noise,
        modelica=written.text if written is not None else "",
        modelica_path=written.path.name if written is not None else "",
        diff=written.diff if written is not None else "",
        separate=_separating_experiments(context, conclusion, same),
        story=(*_restrictions(context.settings), *_story(context, conclusion, sentence)),
        simulations=context.statistics.simulations,
        failures=context.statistics.failures,
        seconds=dict(context.statistics.seconds),
        words={id_: context.family.describe(id_) for id_ in sorted(rivals)},
        added=written.parameters if written is not None else (),
        diagnosis=base.diagnosis,
        interpolation=conclusion.calibration.data.interpolation,
        recordings=context.recordings,
        plain=context.family.base_model(),
        calibrated=_calibrated(context.family.base_model().source, conclusion, fitted),
        blocks=conclusion.choice.comparison.blocks,
    )


def _identifiability(context: LoopContext, calibration: Calibration, refit: Optimum) -> Identifiability:
    """What the data say of each parameter of the model that came out."""
    with context.open(calibration.problem()) as simulator:
        found, _ = assess_columns(context.objective(calibration, simulator), refit, refit.free)
    part = ParameterSet(tuple(calibration.parameters.items[j] for j in refit.free))
    return with_bounds(found, part, refit.coordinates[list(refit.free)])


def _calibrated(
    source: ModelicaSource | None, conclusion: Conclusion, fitted: Mapping[str, NewParameter]
) -> CalibratedModel | None:
    """The model that came out with all its values; none where it came as an FMU."""
    if source is None:
        return None
    calibration, written = conclusion.calibration, conclusion.written
    values = calibration.parameters.from_search(conclusion.refit.coordinates)
    name, added = (source.name, {}) if written is None else (written.name, {written.path.name: written.text})
    new = () if written is None else written.parameters
    delays = [p.name for p in new if isinstance(p.target, DelayTarget)]
    return calibrated_model(calibration, values, fitted, source=replace(source, name=name), added=added, delays=delays)


def _equivalent(conclusion: Conclusion) -> tuple[tuple[str, ...], ...]:
    """Classes of terms that the data do not tell apart; the last one is of terms of which none is named."""
    choice = conclusion.choice
    classes = [choice.alike(t) for t in choice.terms] if conclusion.effects else []
    return tuple(ids for ids in (*classes, choice.undecided) if len(ids) > 1)


def _early_end_sentence(context: LoopContext, where: str) -> str:
    """Where the time limit or an interrupt ended the search; empty where the search was completed."""
    if not where:
        return ""
    limit = f"reached its time limit of {context.settings.max_minutes:g} min"
    ended = "was interrupted" if context.statistics.watched.asked_to_end else limit
    return f" The search {ended} at {where}, so it may have missed effects."


def _restrictions(settings: LoopSettings) -> tuple[str, ...]:
    """What the configuration allows and excludes."""
    only = [*(settings.effects or ()), *(settings.laws or ())]
    lines = [f"The configuration allows only {', '.join(only)}."] if only else []
    lines += [f"The configuration allows effects only at {', '.join(settings.ports)}."] if settings.ports else []
    lines += [f"The configuration excludes {', '.join(settings.exclude)}."] if settings.exclude else []
    return tuple(lines)


def _story(context: LoopContext, conclusion: Conclusion, sentence: str) -> tuple[str, ...]:
    explored, base = conclusion.choice.explored, conclusion.base
    worst = max(base.reports, key=lambda r: r.ratio)
    lines = [
        f"{context.family.title} was fitted as given. Its residual of {worst.output} in {worst.recording} is "
        f"{worst.ratio:.2g} times the noise floor and {worst.verdict}.",
        *base.start_warnings,
        _data_sentence(context),
        _comparison_sentence(conclusion),
    ]
    lines += [f"Step {s.number}: {s.why}." for s in conclusion.steps]
    if explored.skipped:
        lines.append(f"Not tried, because the model with them cannot be simulated: {', '.join(explored.skipped)}.")
    for effect in conclusion.effects:
        values = ", ".join(with_unit(f"{p.name} = {p.value:.3g}", p.unit) for p in effect.parameters)
        lines.append(f"Added at port {effect.port}: {effect.id}, with {values}.")
    return (*lines, sentence)


def _data_sentence(context: LoopContext) -> str:
    """Which readings were fitted and which were used for the test."""
    recordings = context.recordings
    fitted = join_names([r.name for r in recordings.train])
    if recordings.unseen_from:
        ends = ", ".join(f"{name} from {time:.3g} s" for name, time in recordings.unseen_from.items())
        return f"Fit and choice used the first part of {fitted}. The rest ({ends}) only tested the result."
    unseen = join_names([r.name for r in recordings.test])
    return f"Recordings for fit and choice: {fitted}. Recordings that only tested the result: {unseen}."


def _comparison_sentence(conclusion: Conclusion) -> str:
    """How many structures were compared, and how."""
    choice = conclusion.choice
    return (
        f"{len(choice.explored.fits)} model structures were compared by their error on readings that were left out, in "
        f"{choice.comparison.blocks} blocks; the {len(choice.comparison.squares)} best were fitted again without each "
        "block."
    )


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
    context: LoopContext, conclusion: Conclusion, classes: Sequence[Sequence[str]]
) -> tuple[str, ...]:
    """For the first class of equivalent terms: the experiments that would separate them, on a rig that is known."""
    if not classes or context.family.base_model().declared.limits.input is None:
        return ()
    (first, *others), fits = classes[0], conclusion.choice.explored.fits
    rest, lines = conclusion.choice.structure.minus(first), list[str]()
    chosen = fits.get(rest.plus(first))
    for other in others[:2]:
        rival = fits.get(rest.plus(other))
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
                f"{apart.log_evidence:.0f}); `aero-bayes design --separate {first} {other}` writes the signal."
            )
    return tuple(lines)
