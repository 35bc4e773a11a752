"""The loop's conclusion as plain values: what changed in the model's source, and the story in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.design import FAMILIES, SearchSettings, separating_experiment
from aero_bayes.display import join_names, with_unit
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel, calibrated_model
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.deciding_constants import name_deciding_constants
from aero_bayes.estimate.fit import assess_columns, with_bounds
from aero_bayes.estimate.identifiability import Identifiability
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.judge.prediction import shifts
from aero_bayes.loop.conclude import Conclusion
from aero_bayes.loop.extend import fitted_parameters
from aero_bayes.loop.found_effect import NewParameter
from aero_bayes.loop.held_values import Doubt
from aero_bayes.loop.result import LoopResult
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.loop.steps import equivalents, in_order
from aero_bayes.loop.workbench import Workbench
from aero_bayes.search.models import FittedModel
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.model import ModelicaSource

FloatArray = NDArray[np.float64]

#: Search for a separating experiment within the loop: few signals, of few jumps; the command ``design`` tries more.
EXPERIMENT_SEARCH = SearchSettings(start=3, rounds=0, among=tuple(f for f in FAMILIES if f.jumps))


def result_of(bench: Workbench, conclusion: Conclusion, doubted: Sequence[Doubt]) -> LoopResult:
    """All that the loop found, as plain values."""
    base, written, effects = conclusion.base, conclusion.written, conclusion.effects
    named = any(effect.kind == "catalogue" for effect in effects)
    same = _equivalent(bench.settings, conclusion) if named else ()
    parameters = base.plain.parameters
    fitted = fitted_parameters(conclusion.calibration.parameters, conclusion.refit)
    moved = shifts(parameters, base.fit, conclusion.calibration.parameters, conclusion.refit) if effects else ()
    rivals = {r.id for step in conclusion.steps for r in step.rivals}
    sentence = conclusion.sentence + _doubted(doubted) + _ended(bench.settings, conclusion.explored.ended)
    return LoopResult(
        outcome=conclusion.outcome,
        sentence=sentence,
        base=bench.family.base,
        model=written.name if written is not None else bench.family.base,
        effects=effects,
        equivalent=same,
        before=conclusion.before,
        after=conclusion.after,
        floors=base.floors,
        residual_before=base.reports,
        residual_after=conclusion.reports,
        steps=conclusion.steps,
        shifts=moved,
        parameters=fitted,
        identifiability=_identifiability(bench, conclusion.calibration, conclusion.refit),
        noise=conclusion.refit.noise,
        modelica=written.text if written is not None else "",
        modelica_path=written.path.name if written is not None else "",
        diff=written.diff if written is not None else "",
        separate=_separating_experiments(bench, conclusion, same),
        story=(*_choices(bench.settings), *_story(bench, conclusion, sentence)),
        simulations=bench.tally.simulations,
        failures=bench.tally.failures,
        seconds=dict(bench.tally.seconds),
        words={id_: bench.family.describe(id_) for id_ in sorted(rivals)},
        added=written.parameters if written is not None else (),
        interpolation=conclusion.calibration.interpolation,
        recordings=bench.recordings,
        plain=bench.family.base_model(),
        calibrated=_calibrated(bench.family.base_model().source, conclusion, fitted),
    )


def _identifiability(bench: Workbench, calibration: Calibration, refit: Optimum) -> Identifiability:
    """What the data say of each parameter of the model that came out."""
    with bench.open(calibration.problem()) as simulator:
        found, _ = assess_columns(bench.objective(calibration, simulator), refit, refit.free)
    part = ParameterSet(tuple(calibration.parameters.items[j] for j in refit.free))
    found = with_bounds(found, part, refit.coordinates[list(refit.free)])
    return name_deciding_constants(found, calibration, refit, bench.open)


def _calibrated(
    source: ModelicaSource | None, conclusion: Conclusion, fitted: Mapping[str, NewParameter]
) -> CalibratedModel | None:
    """The model that came out with all its values; none where it came as an FMU."""
    if source is None:
        return None
    calibration, written = conclusion.calibration, conclusion.written
    values = calibration.parameters.from_search(conclusion.refit.coordinates)
    name, added = (source.name, {}) if written is None else (written.name, {written.path.name: written.text})
    return calibrated_model(calibration, values, fitted, source=replace(source, name=name), added=added)


def _equivalent(settings: LoopSettings, conclusion: Conclusion) -> tuple[tuple[str, ...], ...]:
    """Classes of terms that the data do not tell apart."""
    explored, chosen = conclusion.explored, conclusion.chosen
    classes = [equivalents(explored, chosen, t, settings.structures.equivalence) for t in in_order(explored, chosen)]
    return tuple(ids for ids in classes if len(ids) > 1)


def _doubted(doubted: Sequence[Doubt]) -> str:
    """The likeliest held value, if any, that explains as much as a term that is named."""
    if not doubted:
        return ""
    d = min(doubted, key=lambda doubt: doubt.behind)
    value = with_unit(f"{d.value:.3g}", d.unit)
    return (
        f" Or {d.parameter} is {value}, not the {d.held:.3g} at which it is held: that explains as much as {d.effect}."
    )


def _ended(settings: LoopSettings, where: str) -> str:
    """Where the search ended before its end, and why; empty where it came to its end."""
    if not where:
        return ""
    return f" The search had {settings.max_minutes:g} min, which were over in {where}: there may be more to find."


def _choices(settings: LoopSettings) -> tuple[str, ...]:
    """What the engineer decided before the search."""
    only = [*(settings.effects or ()), *(settings.laws or ())]
    lines = [f"Only {', '.join(only)} may be named, by the engineer's choice."] if only else []
    lines += (
        [f"Only the port {' or '.join(settings.ports)} counts, by the engineer's choice."] if settings.ports else []
    )
    lines += [f"Refused by the engineer: {', '.join(settings.exclude)}."] if settings.exclude else []
    return tuple(lines)


def _story(bench: Workbench, conclusion: Conclusion, sentence: str) -> tuple[str, ...]:
    explored, base = conclusion.explored, conclusion.base
    worst = max(base.reports, key=lambda r: r.ratio)
    lines = [
        f"Fitted as it stands, {bench.family.title} leaves {worst.ratio:.2g} times the noise floor in {worst.output}"
        f" ({worst.recording}); its residual is {worst.verdict}.",
        *base.far_starts,
        _readings(bench),
        _compared(conclusion),
    ]
    lines += [f"Step {s.number}: {s.why}." for s in conclusion.steps]
    if explored.skipped:
        lines.append(f"Not tried, as the model cannot be simulated with them: {', '.join(explored.skipped)}.")
    for effect in conclusion.effects:
        values = ", ".join(with_unit(f"{p.name} = {p.value:.3g}", p.unit) for p in effect.parameters)
        lines.append(f"Added at the {effect.port} port: {effect.id} ({values}).")
    return (*lines, sentence)


def _readings(bench: Workbench) -> str:
    """Which readings did what."""
    recordings = bench.recordings
    fitted = join_names([r.name for r in recordings.train])
    if recordings.held_from:
        ends = ", ".join(f"{name} from {time:.3g} s" for name, time in recordings.held_from.items())
        return f"Fitted and chosen on the beginning of {fitted}; the end ({ends}) was looked at once, after the choice."
    unseen = join_names([r.name for r in recordings.test])
    return f"Fitted and chosen on {fitted}; {unseen} was looked at once, after the choice."


def _compared(conclusion: Conclusion) -> str:
    """What the evidence rests on."""
    explored = conclusion.explored
    counts = ", ".join(f"{n:.0f} of {o}" for o, n in explored.noise.effective_samples.items())
    return (
        f"{len(explored.fits)} structures were compared under one noise; the readings count for {counts} independent "
        "ones."
    )


@dataclass(frozen=True, eq=False)
class _Rival:
    """A model with some terms as it was fitted, the others out of it: what an experiment is designed from."""

    calibration: Calibration
    values: FloatArray
    free: tuple[int, ...]
    noise: Mapping[str, OutputNoise]
    covariance: FloatArray

    @classmethod
    def of(cls, fitted: FittedModel) -> _Rival:
        fit, calibration = fitted.optimum, fitted.model.objective.calibration
        items, values = calibration.parameters.items, calibration.parameters.from_search(fit.coordinates)
        columns, targets = list(fit.free), [(j, p.target) for j, p in enumerate(items) if j not in fit.free]
        held_at = {t.name: float(values[j]) for j, t in targets if isinstance(t, ParameterTarget)}
        own = replace(
            calibration,
            parameters=ParameterSet(tuple(items[j] for j in columns)),
            fixed={**calibration.fixed, **held_at},
        )
        return cls(own, values[columns], tuple(range(len(columns))), fit.noise, fit.covariance)


def _separating_experiments(
    bench: Workbench, conclusion: Conclusion, classes: Sequence[Sequence[str]]
) -> tuple[str, ...]:
    """For the first class of equivalent terms: the experiments that would separate them, on a rig that is known."""
    if not classes or bench.family.base_model().declared.limits.input is None:
        return ()
    chosen, (first, *others) = conclusion.chosen, classes[0]
    lines = []
    for other in others[:2]:
        rival = conclusion.explored.fits.get(chosen.structure.minus(first).plus(other))
        pair = f"{first} from {other}"
        if rival is None:
            continue
        try:
            apart = separating_experiment(
                _Rival.of(chosen), _Rival.of(rival), workers=bench.pool.size,
                settings=replace(EXPERIMENT_SEARCH, seed=bench.settings.seed),
            )  # fmt: skip
        except (InputError, CannotFinishError):
            continue
        if apart.log_evidence < 1.0:
            lines.append(f"None of the experiments tried would tell {pair}.")
        else:
            lines.append(
                f"To tell {pair}: {apart.in_words} (expected difference in log-evidence {apart.log_evidence:.0f}); "
                "`aero-bayes design --loop` writes the signal."
            )
    return tuple(lines)
