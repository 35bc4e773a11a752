"""The chosen terms go into the model: written as Modelica, exported, and refitted on all parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.check.residual_tests import ResidualReport, check_residuals
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.finished_fit import finished_fit
from aero_bayes.estimate.global_search import GlobalSearch, GlobalSearchResult
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.judge.choice import Choice
from aero_bayes.judge.prediction import Prediction
from aero_bayes.laws.model_family import CurveBasis, ExtendedModel
from aero_bayes.loop.base_fit import BaseFit
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.found_effect import FoundEffect, LearnedCurve, NewParameter


@dataclass(frozen=True, eq=False)
class ExtendedFit:
    """The model with the chosen terms, fitted: source, parameters, what it leaves and what it predicts.

    ``found`` is ``fit`` with what is told of a fit."""

    written: ExtendedModel
    effects: tuple[FoundEffect, ...]
    smaller: tuple[FoundEffect, ...]
    calibration: Calibration
    fit: Optimum
    reports: tuple[ResidualReport, ...]
    after: Prediction
    found: Fit


def extend(context: LoopContext, base: BaseFit, choice: Choice) -> ExtendedFit:
    """Write the chosen structure into the model, with smaller effects where these are wanted, and
    fit it at its best."""
    context.progress("writing the extended model", 0.75)
    smaller = choice.smaller if context.settings.include_smaller else ()
    terms, chosen = (*choice.terms, *smaller), choice.explored.fits[choice.structure.plus(*smaller)]
    values = dict(chosen.values)
    written = context.family.extend(terms, values, context.folder)
    context.statistics.written.append(written.path)
    values |= {new: values[old] for pairs in written.names.values() for old, new in pairs}
    context.statistics.end_stage("extension")
    context.progress("refitting the extended model", 0.85)
    calibration = base.with_terms(context, written.model, written.parameters)
    with context.open(calibration.problem()) as simulator:
        objective = context.objective(calibration, simulator)
        si = np.array([values.get(p.name, p.start) for p in calibration.parameters])
        start = calibration.parameters.to_search(si)
        free = [j for j, p in enumerate(calibration.parameters) if not p.free_if_identified]
        search = GlobalSearch(objective, context.settings.global_search)
        fit = search.refit(start, free, base.fit.noise)
        found = finished_fit(
            search, GlobalSearchResult(fit, None, (), search.iterations), context.settings.fitting, 0.0
        )
        reports = check_residuals(calibration, objective.series, fit, base.floors)
        context.statistics.add_simulations(objective)
    after = context.unseen.predict(calibration, fit)
    effects = []
    for id_ in terms:
        effect = _effect(context, choice, id_, (written, calibration.parameters, fit))
        effects.append(replace(effect, width_influence=_width_influence(context, effect, calibration, fit)))
    context.statistics.end_stage("judgement")
    named = len(choice.terms)
    return ExtendedFit(written, tuple(effects[:named]), tuple(effects[named:]), calibration, fit, reports, after, found)


def smaller_effects(context: LoopContext, choice: Choice) -> tuple[FoundEffect, ...]:
    """Effects that help beside the chosen ones and are not material, as the search fitted them."""
    if not choice.smaller:
        return ()
    fitted = choice.explored.fits[choice.structure.plus(*choice.smaller)]
    parameters, found = fitted_parameters(fitted.model.objective.parameters, fitted.optimum), []
    for id_ in choice.smaller:
        share, names = choice.share_of_smaller(id_), fitted.term_values(id_)
        found.append(
            FoundEffect(
                id_, choice.explored.ports[id_], "catalogue", tuple(parameters[n] for n in names), share.value,
                share.sd, share.output, choice.wins_of_smaller(id_), context.family.describe(id_),
            )
        )  # fmt: skip
    return tuple(found)


def _effect(
    context: LoopContext, choice: Choice, id_: str, made: tuple[ExtendedModel, ParameterSet, Optimum]
) -> FoundEffect:
    written, parameters, fit = made
    named = fitted_parameters(parameters, fit)
    over = context.family.curves().get(id_, "")
    columns = [parameters.index(new) for _, new in written.names[id_]]
    small = id_ in choice.smaller
    share = choice.share_of_smaller(id_) if small else choice.share(id_)
    return FoundEffect(
        id_, choice.explored.ports[id_], "free_form" if over else "catalogue",
        tuple(named[new] for _, new in written.names[id_]), share.value, share.sd, share.output,
        choice.wins_of_smaller(id_) if small else choice.wins, context.family.describe(id_),
        dict(written.widths[id_]), over=over, looks_like=choice.looks_like(id_) if over else "",
        curve=_learned(context.family.basis(id_), columns, parameters, fit) if over else None,
    )  # fmt: skip


def fitted_parameters(parameters: ParameterSet, fit: Optimum) -> dict[str, NewParameter]:
    """Return values with Laplace's intervals, which are symmetric on a parameter's own search axis."""
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


def _learned(basis: CurveBasis, columns: list[int], parameters: ParameterSet, fit: Optimum) -> LearnedCurve:
    """Return a curve at the fit, and how sure it is."""
    values = parameters.from_search(fit.coordinates)
    heights, scale = values[columns], parameters.jacobian(values)[columns]
    rows = [fit.free.index(j) for j in columns]
    covariance = fit.covariance[np.ix_(rows, rows)] * np.outer(scale, scale)
    variance = np.einsum("kn,kl,ln->n", basis.rows, covariance, basis.rows)
    return LearnedCurve(
        basis.x, basis.plain + heights @ basis.rows, np.sqrt(np.maximum(variance, 0.0)), basis.x_unit, basis.unit
    )


def _width_influence(context: LoopContext, effect: FoundEffect, calibration: Calibration, fit: Optimum) -> float | None:
    """Return by how many standard deviations an effect's parameters move when its smoothing widths are doubled."""
    doubled: Mapping[str, float] = {
        variable.name: 2.0 * width
        for name, width in effect.widths.items()
        for variable in calibration.model.parameters
        if variable.name.rpartition(".")[2] == name
    }
    if not doubled:
        return None
    wider = calibration.with_fixed(doubled)
    settings = LocalFitSettings(hold_noise=True).with_limits(4, 0.02)
    try:
        with context.open(wider.problem()) as simulator:
            again = local_fit(
                context.objective(wider, simulator), fit.coordinates, fit.free, noise=fit.noise, settings=settings
            )
    except CannotFinishError:
        return None
    columns = [calibration.parameters.index(p.name) for p in effect.parameters]
    moved = [abs(again.coordinates[j] - fit.coordinates[j]) / max(fit.sd(j), 1e-300) for j in columns]
    return max(moved, default=math.nan)
