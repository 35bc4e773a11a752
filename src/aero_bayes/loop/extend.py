"""What was found goes into the model: written as Modelica, exported, refitted on all parameters, and judged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.check.structure import TIMES_FLOOR, ResidualReport, inspect, those_structured
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import Optimum, climb
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.loop.conclusion import Conclusion
from aero_bayes.loop.judge import gain_text
from aero_bayes.loop.result import FoundEffect, LearnedCurve
from aero_bayes.loop.rounds import Selection
from aero_bayes.loop.search import Found
from aero_bayes.loop.tell import fitted_parameters
from aero_bayes.loop.workbench import Workbench
from aero_bayes.physics.kin import Basis, Extension
from aero_bayes.show import listed

#: What an effect may be instead is named where it is no more than so many.
NAMED = 2


def add_effects(bench: Workbench, found: Found) -> Conclusion:
    """Write the selected effects of the catalogue into the model."""
    selection = found.selection
    bench.progress("writing the extended model", 0.75)
    values = selection.held.values
    written = bench.family.extend(selection.effects, values, bench.folder)
    bench.tally.written.append(written.path)
    values |= {new: values[old] for pairs in written.names.values() for old, new in pairs}
    bench.tally.lap("extension")
    bench.progress("refitting the extended model", 0.85)
    calibration = found.base.on(bench, written.model, written.parameters)
    study, fit = _final_fit(bench, found, calibration, values, selection.held.optimum)
    reports = inspect(calibration, study.series, fit, found.base.floors)
    after = bench.unseen.predict(calibration, fit)
    bench.tally.count(study)
    study.simulator.close()
    effects = tuple(_found_effect(bench, c, selection, written, calibration.parameters, fit) for c in selection.effects)
    effects = tuple(replace(e, width_influence=_width_influence(bench, found, e, calibration, fit)) for e in effects)
    structured = those_structured(reports)
    required = bench.settings.attribute.require
    told = sorted(effects, key=lambda e: e.kind)  # what has a name first
    same = selection.equivalent
    given, lacking = ([_in_words(e, same) for e in told if (e.id in required) is asked] for asked in (True, False))
    said = [f"was given {listed(given)}, as required"] if given else []
    said += [f"lacks {listed(lacking)}"] if lacking else []
    sentence = f"The model {', and '.join(said)}: " + gain_text(found.before, after, bench.units)
    if structured:
        sentence += f" Some structure is left in {', '.join(_left(structured))}."
    bench.tally.lap("judgement")
    return Conclusion(found, "extended", sentence, written, effects, calibration, fit, reports, after)


def _left(structured: Sequence[ResidualReport]) -> list[str]:
    """Outputs with structure, with how far it is above the noise where it is far."""
    worst: dict[str, float] = {}
    for report in structured:
        worst[report.output] = max(report.ratio, worst.get(report.output, 0.0))
    how = {o: f"{w:.2g}" if w < 100.0 else "more than a hundred" for o, w in worst.items()}
    return [f"{o} ({how[o]} times the noise floor)" if worst[o] > TIMES_FLOOR else o for o in sorted(worst)]


def _in_words(effect: FoundEffect, equivalent: Sequence[Sequence[str]]) -> str:
    """An effect, and what it may be instead: the data cannot tell."""
    if effect.kind == "catalogue":
        others = list(dict.fromkeys(i for ids in equivalent if effect.id in ids for i in ids if i != effect.id))
        if not others:
            return effect.id
        instead = " or ".join(others) if len(others) <= NAMED else f"one of {len(others)} others"
        return f"{effect.id} (or {instead}, which the data cannot tell from it)"
    return f"something at {effect.port} that no listed law describes, learned as a curve over {effect.over}"


def _final_fit(
    bench: Workbench,
    found: Found,
    calibration: Calibration,
    start: Mapping[str, float],
    warm: Optimum,
) -> tuple[Objective, Optimum]:
    """Optimum on the exported model itself, from where the search ended."""
    parameters = calibration.parameters
    at = parameters.to_search(np.array([start[name] for name in parameters.names]))
    study = bench.open_objective(calibration)
    free = [j for j, p in enumerate(parameters) if not p.auto]
    return study, climb(study, at, free, noise=warm.noise, settings=found.base.settings)


def _found_effect(
    bench: Workbench,
    id_: str,
    selection: Selection,
    written: Extension,
    parameters: ParameterSet,
    fit: Optimum,
) -> FoundEffect:
    named = fitted_parameters(parameters, fit)
    scored = [(r, s) for r in selection.rounds for s in r.scores if s.candidate.id == id_ and s.held is not None]
    chosen = [(r, s) for r, s in scored if r.chosen is not None and r.chosen.candidate.id == id_] or scored
    found, gain = (chosen[0][0], chosen[0][1].gain) if chosen else (None, math.nan)
    same = {id_, *(found.equivalent if found is not None else ())}
    over = bench.family.learned().get(id_, "")
    columns = [parameters.index(new) for _, new in written.names[id_]]
    return FoundEffect(
        id_, selection.held.stand.candidates[id_].port, "free_form" if over else "catalogue",
        tuple(named[new] for _, new in written.names[id_]), gain,
        found.threshold if found is not None else math.nan, bench.family.summary(id_),
        dict(written.widths[id_]),
        over=over,
        odds=sum(s.odds for s in found.scores if s.candidate.id in same) if found is not None else None,
        curve=_learned(bench.family.basis(id_), columns, parameters, fit) if over else None,
    )  # fmt: skip


def _learned(basis: Basis, columns: list[int], parameters: ParameterSet, fit: Optimum) -> LearnedCurve:
    """A curve at the fit, and how sure it is."""
    values = parameters.from_search(fit.coordinates)
    heights, scale = values[columns], parameters.jacobian(values)[columns]
    rows = [fit.free.index(j) for j in columns]
    covariance = fit.covariance[np.ix_(rows, rows)] * np.outer(scale, scale)
    variance = np.einsum("kn,kl,ln->n", basis.rows, covariance, basis.rows)
    return LearnedCurve(
        basis.x, basis.plain + heights @ basis.rows, np.sqrt(np.maximum(variance, 0.0)), basis.x_unit, basis.unit
    )


def _width_influence(
    bench: Workbench, found: Found, effect: FoundEffect, calibration: Calibration, fit: Optimum
) -> float | None:
    """By how many standard deviations an effect's parameters move when its smoothing widths are doubled."""
    doubled = {
        variable.name: 2.0 * width
        for name, width in effect.widths.items()
        for variable in calibration.model.parameters
        if variable.name.rpartition(".")[2] == name
    }
    if not doubled:
        return None
    study = bench.open_objective(replace(calibration, fixed={**calibration.fixed, **doubled}))
    try:
        again = climb(study, fit.coordinates, fit.free, noise=fit.noise, settings=found.base.settings.rough(4, 0.02))
    except CannotFinishError:
        return None
    finally:
        study.simulator.close()
    columns = [calibration.parameters.index(p.name) for p in effect.parameters]
    moved = [abs(again.coordinates[j] - fit.coordinates[j]) / max(fit.sd(j), 1e-300) for j in columns]
    return float(max(moved))
