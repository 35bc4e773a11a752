"""The loop's conclusion told: values with intervals, what changed in the model's source, and the story in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.design import FAMILIES, SearchSettings, separating_experiment
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import Optimum
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.loop.conclusion import Conclusion
from aero_bayes.loop.judge import shifts
from aero_bayes.loop.result import LoopResult, NewParameter
from aero_bayes.loop.search import Found
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.loop.stand import Held
from aero_bayes.loop.workbench import Workbench
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.show import with_unit
from aero_bayes.simulation.interface import ParameterTarget

FloatArray = NDArray[np.float64]

#: How far a loop looks for an experiment, among signals of few jumps; the command for designs looks further.
EFFORT = SearchSettings(start=3, rounds=0, among=tuple(f for f in FAMILIES if f.jumps))


def result_of(bench: Workbench, conclusion: Conclusion) -> LoopResult:
    """All that the loop found, as plain values."""
    found = conclusion.found
    base, selection = found.base, found.selection
    written, effects = conclusion.written, conclusion.effects
    named = any(effect.kind == "catalogue" for effect in effects)
    parameters = base.plain.parameters
    moved = shifts(parameters, base.fit, conclusion.calibration.parameters, conclusion.refit) if effects else ()
    return LoopResult(
        outcome=conclusion.outcome,
        sentence=conclusion.sentence + _doubted(conclusion) + _ended(bench.settings, found),
        base=bench.family.base,
        model=written.name if written is not None else bench.family.base,
        effects=effects,
        equivalent=selection.equivalent if named else (),
        before=found.before,
        after=conclusion.after,
        floors=base.floors,
        residual_before=base.reports,
        residual_after=conclusion.reports,
        rounds=selection.rounds,
        shifts=moved,
        parameters=fitted_parameters(conclusion.calibration.parameters, conclusion.refit),
        noise=conclusion.refit.noise,
        modelica=written.text if written is not None else "",
        modelica_path=written.path.name if written is not None else "",
        diff=written.diff if written is not None else "",
        separate=_separating_experiments(bench, found) if named else (),
        story=(*_choices(bench.settings), *_story(bench.family.title, conclusion)),
        simulations=bench.tally.simulations,
        failures=bench.tally.failures,
        seconds=dict(bench.tally.seconds),
        words={s.candidate.id: bench.family.summary(s.candidate.id) for r in selection.rounds for s in r.scores},
        added=written.parameters if written is not None else (),
        recordings=bench.recordings,
        plain=bench.family.plain(),
    )


def _doubted(conclusion: Conclusion) -> str:
    """The likeliest held value, if any, that explains as much as an effect that is named."""
    named = {effect.id for effect in conclusion.effects}
    doubted = [doubt for doubt in conclusion.found.selection.doubts if doubt.effect in named]
    if not doubted:
        return ""
    d = min(doubted, key=lambda doubt: doubt.behind)
    value = with_unit(f"{d.value:.3g}", d.unit)
    return (
        f" Or {d.parameter} is {value}, not the {d.held:.3g} at which it is held: that explains as much as {d.effect}."
    )


def _ended(settings: LoopSettings, found: Found) -> str:
    """Where the search ended before its end, and why; empty where it came to its end."""
    where = found.selection.ended
    if not where:
        return ""
    return f" The search had {settings.max_minutes:g} min, which were over in {where}: there may be more to find."


def fitted_parameters(parameters: ParameterSet, fit: Optimum) -> dict[str, NewParameter]:
    """Values with Laplace's intervals, which are symmetric on a parameter's own search axis."""
    values = parameters.from_search(fit.coordinates)
    low, high = parameters.box
    found = {}
    for j in fit.free:
        item = parameters.items[j]
        sd = fit.sd(j)
        ends = np.repeat(fit.coordinates[np.newaxis, :], 2, axis=0)
        ends[:, j] = np.clip(fit.coordinates[j] + np.array([-1.645, 1.645]) * sd, low[j], high[j])
        q05, q95 = parameters.from_search(ends)[:, j]
        slope = float(parameters.jacobian(values)[j])
        found[item.name] = NewParameter(
            item.name, float(values[j]), sd * slope, float(q05), float(q95), item.unit, item.description
        )
    return found


def _choices(settings: LoopSettings) -> tuple[str, ...]:
    """What the engineer decided before the search."""
    only = [*(settings.effects or ()), *(settings.laws or ())]
    lines = [f"Only {', '.join(only)} may be named, by the engineer's choice."] if only else []
    lines += (
        [f"Only the port {' or '.join(settings.ports)} counts, by the engineer's choice."] if settings.ports else []
    )
    lines += [f"Refused by the engineer: {', '.join(settings.exclude)}."] if settings.exclude else []
    return tuple(lines)


def _story(title: str, conclusion: Conclusion) -> tuple[str, ...]:
    found = conclusion.found
    worst = max(found.base.reports, key=lambda r: r.ratio)
    lines = [
        f"Fitted as it stands, {title} leaves {worst.ratio:.2g} times the noise floor in {worst.output}"
        f" ({worst.recording}); its residual is {worst.verdict}."
    ]
    lines += [f"Round {r.number}: {r.why}." for r in found.selection.rounds]
    if found.selection.skipped:
        lines.append(f"Not tried, as the model cannot be simulated with them: {', '.join(found.selection.skipped)}.")
    for effect in conclusion.effects:
        values = ", ".join(with_unit(f"{p.name} = {p.value:.3g}", p.unit) for p in effect.parameters)
        lines.append(f"Added at the {effect.port} port: {effect.id} ({values}).")
    return (*lines, conclusion.sentence)


@dataclass(frozen=True, eq=False)
class _Rival:
    """A model with some effects as it was fitted, the others out of it: what an experiment is designed from."""

    calibration: Calibration
    values: FloatArray
    free: tuple[int, ...]
    noise: Mapping[str, OutputNoise]
    covariance: FloatArray

    @classmethod
    def of(cls, held: Held) -> _Rival:
        fit, calibration = held.optimum, held.stand.study.calibration
        items, values = calibration.parameters.items, calibration.parameters.from_search(fit.coordinates)
        columns, targets = list(fit.free), [(j, p.target) for j, p in enumerate(items) if j not in fit.free]
        held_at = {t.name: float(values[j]) for j, t in targets if isinstance(t, ParameterTarget)}
        own = replace(
            calibration,
            parameters=ParameterSet(tuple(items[j] for j in columns)),
            fixed={**calibration.fixed, **held_at},
        )
        return cls(own, values[columns], tuple(range(len(columns))), fit.noise, fit.covariance)


def _separating_experiments(bench: Workbench, found: Found) -> tuple[str, ...]:
    """For the first class of equivalent effects: the experiments that would separate them, on a rig that is known."""
    if not found.selection.equivalent or bench.family.plain().declared.limits.input is None:
        return ()
    same = found.selection.equivalent[0]
    scores = [s for r in reversed(found.selection.rounds) for s in r.scores]
    held = {s.candidate.id: s.held for s in scores if s.held is not None and s.candidate.id in same}
    first, *others = [id_ for id_ in same if id_ in held] or [""]
    lines = []
    for other in others[:2]:
        pair = f"{first} from {other}"
        try:
            apart = separating_experiment(
                _Rival.of(held[first]), _Rival.of(held[other]), workers=bench.pool.size,
                settings=replace(EFFORT, seed=bench.settings.seed),
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
