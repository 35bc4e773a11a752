"""What was found goes into the model: written as Modelica, exported, refitted on all parameters, and judged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.discrepancy.attribute import Candidate, Selection
from aero_bayes.discrepancy.baseline import nuisance_parameters
from aero_bayes.discrepancy.beyond import CurveFit
from aero_bayes.discrepancy.catalogue import effect_parameter
from aero_bayes.discrepancy.conclusion import Conclusion
from aero_bayes.discrepancy.refit import Refit, SmoothPrior, refit
from aero_bayes.discrepancy.residual import inspect
from aero_bayes.discrepancy.result import FoundEffect
from aero_bayes.discrepancy.search import Found
from aero_bayes.discrepancy.study import Study
from aero_bayes.discrepancy.tell import fitted_parameters, gain_text
from aero_bayes.discrepancy.workbench import Workbench
from aero_bayes.errors import CannotFinishError
from aero_bayes.export import CATALOGUE, EffectUse, FreeForm
from aero_bayes.inference.parameters import Parameter, ParameterSet
from aero_bayes.simulation import Model


def add_effects(bench: Workbench, found: Found) -> Conclusion:
    """Write the selected effects of the catalogue into the model."""
    selection, everything = found.selection, found.base.everything
    bench.progress("writing the extended model", 0.75)
    values = dict(zip(everything.names, everything.from_search(selection.refit.coordinates), strict=True))
    uses = [
        EffectUse(c.id, {p.name: _significant(values[p.name]) for p in CATALOGUE[c.id].parameters})
        for c in selection.effects
    ]
    written, model = bench.family.with_effects(uses, bench.folder)
    bench.tally.lap("extension")
    bench.progress("refitting the extended model", 0.85)
    new = [effect_parameter(p) for c in selection.effects for p in CATALOGUE[c.id].parameters]
    parameters, study, fit = _final_fit(bench, model, found, new, values, selection.refit)
    reports = inspect(study, fit, found.base.floors_by_index, bench.recordings.names)
    after = bench.predict(model, parameters, fit)
    bench.tally.count(study)
    study.close()
    effects = tuple(_found_effect(c, selection, parameters, fit) for c in selection.effects)
    effects = tuple(
        replace(e, width_influence=_width_influence(bench, model, found, e, parameters, fit)) for e in effects
    )
    structured = [r for r in reports if r.verdict == "structured"]
    sentence = f"The model lacks {' and '.join(e.id for e in effects)}: " + gain_text(found.before, after)
    if structured:
        sentence += f" Some structure is left in {', '.join(sorted({r.output for r in structured}))}."
    bench.tally.lap("judgement")
    return Conclusion("extended", sentence, written, effects, parameters, fit, reports, after)


def add_curve(bench: Workbench, found: Found, curve: CurveFit) -> Conclusion:
    """The port is clear and nothing listed fits: the learned curve goes into the model as a table."""
    bench.progress("writing the learned curve into the model", 0.75)
    values = tuple(_significant(float(v)) for v in curve.values)
    use = FreeForm(curve.port, curve.over, curve.x_min, curve.x_max, values)
    written, model = bench.family.with_effects([use], bench.folder)
    bench.tally.lap("extension")
    start = dict(zip(curve.parameters.names, curve.parameters.from_search(curve.refit.coordinates), strict=True))
    new = [curve.parameters.items[j] for j in curve.columns]
    parameters, study, fit = _final_fit(bench, model, found, new, start, curve.refit, curve.smooth)
    reports = inspect(study, fit, found.base.floors_by_index, bench.recordings.names)
    after = bench.predict(model, parameters, fit)
    bench.tally.count(study)
    study.close()
    named = fitted_parameters(parameters, fit)
    bar = found.selection.rounds[0].threshold if found.selection.rounds else math.nan
    effect = FoundEffect(
        "free_form", curve.port, "free_form", tuple(named[p.name] for p in new),
        curve.refit.log_evidence - found.selection.base.log_evidence, bar,
        f"a learned curve over {curve.over} from {curve.x_min:.3g} to {curve.x_max:.3g}, straight beyond",
        over=curve.over,
    )  # fmt: skip
    rival = [s.candidate.id for s in found.selection.rounds[0].scores[:1]] if found.selection.rounds else []
    sentence = (
        f"Something acts at the {curve.port} port as a function of {curve.over}; no effect of the catalogue fits "
        f"as well{f' (the best is {rival[0]})' if rival else ''}: {gain_text(found.before, after)}"
    )
    bench.tally.lap("judgement")
    return Conclusion("extended", sentence, written, (effect,), parameters, fit, reports, after)


def _final_fit(
    bench: Workbench,
    model: Model,
    found: Found,
    new: Sequence[Parameter],
    start: Mapping[str, float],
    warm: Refit,
    smooth: SmoothPrior | None = None,
) -> tuple[ParameterSet, Study, Refit]:
    """Refit on the exported model itself, from where the search ended."""
    prepared = found.base.prepared
    parameters = ParameterSet((*found.base.shared, *nuisance_parameters(prepared, model), *new))
    at = parameters.to_search(np.array([start[name] for name in parameters.names]))
    study = bench.open_study(model, parameters, prepared, {})
    settings = replace(bench.refit_settings(prepared), smooth=smooth)
    return parameters, study, refit(study, at, range(len(parameters)), noise=warm.noise, settings=settings)


def _found_effect(candidate: Candidate, selection: Selection, parameters: ParameterSet, fit: Refit) -> FoundEffect:
    effect = CATALOGUE[candidate.id]
    named = fitted_parameters(parameters, fit)
    found = next((r for r in selection.rounds if r.chosen is not None and r.chosen.candidate is candidate), None)
    gain = found.chosen.gain if found is not None and found.chosen is not None else math.nan
    return FoundEffect(
        effect.id, effect.port, "catalogue", tuple(named[p.name] for p in effect.parameters), gain,
        found.threshold if found is not None else math.nan, effect.summary, dict(effect.widths),
    )  # fmt: skip


def _width_influence(
    bench: Workbench, model: Model, found: Found, effect: FoundEffect, parameters: ParameterSet, fit: Refit
) -> float | None:
    """By how many standard deviations an effect's parameters move when its smoothing widths are doubled."""
    doubled = {
        variable.name: 2.0 * width
        for name, width in effect.widths.items()
        for variable in model.parameters
        if variable.name.rpartition(".")[2] == name
    }
    if not doubled:
        return None
    study = bench.open_study(model, parameters, found.base.prepared, doubled)
    try:
        settings = replace(bench.refit_settings(found.base.prepared), iterations=4)
        again = refit(study, fit.coordinates, fit.free, noise=fit.noise, settings=settings)
    except CannotFinishError:
        return None
    finally:
        study.close()
    columns = [parameters.index(p.name) for p in effect.parameters]
    moved = [abs(again.coordinates[j] - fit.coordinates[j]) / max(fit.sd(j), 1e-300) for j in columns]
    return float(max(moved))


def _significant(value: float) -> float:
    return float(f"{value:.4g}")
