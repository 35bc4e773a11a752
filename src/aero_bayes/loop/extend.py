"""The chosen terms go into the model: written as Modelica, exported, and refitted on all parameters."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.estimate.input_noise import asked_again
from aero_bayes.estimate.interpolation import MIN_LOG_LIKELIHOOD_GAIN, with_interpolation
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.predict_recordings import Prediction
from aero_bayes.estimate.residual_tests import ResidualReport, check_residuals
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.simulation_error import exact_enough, sharper_model
from aero_bayes.laws.probed_model import CurveBasis, LearnedCurve
from aero_bayes.loop.decide import ClaimKind, Decision
from aero_bayes.loop.first_fit import SEARCHED, FirstFit, LoopContext, refitted
from aero_bayes.loop.modelica_family import ExtendedModel
from aero_bayes.loop.search import Search
from aero_bayes.loop.table import BOTH, Structure, Table, law_of
from aero_bayes.plain import BY_NAME, Number, Rows


@dataclass(frozen=True)
class Alternative:
    """What does as well in the place of an effect, and the left-out error with it over that with the effect."""

    id: str
    port: str
    error_ratio: Number


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was added, and what is claimed of it; ``modelica`` is the file that holds it.

    ``id`` is ``law@port``, ``value@parameter``, ``start@state`` or an id of a library.

    ``share`` is the error on left-out readings with it over that without it, in the output ``share_of`` where it falls
    most, and ``share_sd`` its standard error. ``claim`` is None for one that the configuration requires,
    ``tried_all`` whether everything offered was tried in its place."""

    id: str
    port: str
    kind: Literal["catalogue", "free_form"]
    parameters: Rows[Estimate] = field(default=(), metadata=BY_NAME)
    share: Number = math.nan
    share_sd: Number = math.nan
    share_of: str = ""
    claim: ClaimKind | None = None
    alternatives: tuple[Alternative, ...] = ()
    summary: str = ""
    over: str = ""
    looks_like: str = ""
    curve: LearnedCurve | None = None
    tried_all: bool = True
    modelica: str = ""


@dataclass(frozen=True)
class Limit:
    """The smallest size of a law at a port that would have been named: a value of its first parameter.

    Its signature in the outputs, once the free parameters have readjusted, raises the error that the model leaves by
    so much that taking it away would be material."""

    law: str
    port: str
    parameter: str
    smallest: Number
    unit: str


def limits_of(search: Search, model: Structure) -> tuple[Limit, ...]:
    """What the recordings would have shown beside a structure; what no size shows is left out."""
    return tuple(
        Limit(law_of(id_), found.port, found.parameter[0], found.smallest, found.parameter[1])
        for id_, found in sorted(search.screened.get(model, {}).items())
        if math.isfinite(found.smallest) and id_ not in search.source.held
    )


@dataclass(frozen=True, eq=False)
class ExtendedFit:
    """The model with the chosen terms, fitted: what was written, its parameters, what it leaves and what it predicts.

    ``written`` is None where nothing was added, or only values that were held fixed were wrong."""

    written: ExtendedModel | None
    added: tuple[Parameter, ...]
    effects: tuple[FoundEffect, ...]
    fit: Fit
    reports: tuple[ResidualReport, ...]
    after: Prediction


def extend(context: LoopContext, first: FirstFit, search: Search, decision: Decision) -> ExtendedFit:
    """Write the chosen terms into the model, and fit it at its best."""
    context.statistics.tell("writing the extended model", SEARCHED)
    held = search.source.held
    laws = [t for t in decision.model if t not in held]
    best = search.fits[decision.model]
    values = dict(best.values)
    written = context.family.extend(laws, values, context.folder) if laws else None
    names: dict[str, tuple[tuple[str, str], ...]] = dict(written.names) if written is not None else {}
    values |= {new: values[old] for pairs in names.values() for old, new in pairs if old in values}
    names |= {t: tuple((n, n) for n in best.term_values(t)) for t in decision.model if t in held}
    added = (*(written.parameters if written is not None else ()), *(held[t] for t in decision.model if t in held))
    context.statistics.end_stage("extension")
    context.statistics.tell("refitting the extended model", 0.92)
    model = written.model if written is not None else first.plain.model
    calibration = first.with_terms(context, model, added)
    known = {first.plain.parameters.names[j] for j in first.fit.free}
    old = set(first.plain.parameters.names) - {p.name for p in added}
    free = tuple(j for j, p in enumerate(calibration.parameters) if p.name in known or p.name not in old)
    si = np.array([values.get(p.name, p.start) for p in calibration.parameters])
    fit = _read_likelier(context, refitted(context, calibration, si, replace(first.fit.optimum, free=free)))
    if (lost := _lost(search, decision.model, fit)) > -math.log(BOTH):
        # Under another noise the outputs have other weights: one may have got worse for the sake of another.
        like = replace(first.fit.optimum, free=free, noise=best.optimum.noise)
        again = refitted(context, calibration, si, like, hold_noise=True)
        fit = again if _lost(search, decision.model, again) < lost else fit
    sharper = sharper_model(model) if written is None else written.sharper
    started = {state for p in added for state in p.starts}
    fit = asked_again(exact_enough(fit, partial(_fitted_again, context), context.open, sharper), started, context.open)
    calibration = fit.calibration
    if written is not None:
        # The search's values are where the last fit began.
        fitted = {name: entry.value for name, entry in fit.parameters.items()}
        written = context.family.with_fitted(written, fitted, added)
    reports = check_residuals(calibration, fit.series, fit.optimum, first.floors)
    after = context.predictor.predict(calibration, fit.optimum)
    file = written.path.name if written is not None else ""
    effects = tuple(
        replace(_effect(context, search.table, decision, id_, [new for _, new in names[id_]], fit), modelica=file)
        for id_ in decision.model
    )
    context.statistics.end_stage("judgement")
    return ExtendedFit(written, added, effects, fit, reports, after)


def _lost(search: Search, terms: Structure, fit: Fit) -> float:
    """Logarithm of a fit's validation error over that of the structure when it was decided on; 0 without validation."""
    table, validation = search.table, search.validation
    decided = table.rows[terms].validation
    if validation is None or decided is None:
        return 0.0
    try:
        found, _ = validation.errors(fit.calibration, fit.optimum)
    except CannotFinishError:
        return math.inf
    return float(np.sum(table.logs(found.sum(axis=0)) - table.logs(decided.sum(axis=0))))


def _read_likelier(context: LoopContext, fit: Fit) -> Fit:
    """The fit with each input read as is likelier, held or linear between its samples.

    That was chosen beside the first model, which leaves too much to tell; half a sample is a delay's worth."""
    if context.settings.fitting.calibration.interpolation != "auto":
        return fit
    for name, how in fit.calibration.data.interpolation.items():
        other = with_interpolation(fit.calibration, {name: "hold" if how == "linear" else "linear"})
        with suppress(CannotFinishError):
            found = _fitted_again(context, other, fit)
            fit = found if found.log_likelihood > fit.log_likelihood + MIN_LOG_LIKELIHOOD_GAIN else fit
    return fit


def _fitted_again(context: LoopContext, other: Calibration, fit: Fit) -> Fit:
    return refitted(context, other, fit.values, replace(fit.optimum, free=fit.free))


def _effect(
    context: LoopContext, table: Table, decision: Decision, id_: str, names: list[str], fit: Fit
) -> FoundEffect:
    """What is said of a term in the model that came out."""
    over = context.family.curves().get(id_, "")
    claim = decision.claims.get(id_)
    others = claim.alternatives if claim is not None else ()
    curve = _learned(context.family.basis(id_), names, fit) if over else None
    ports, known = table.ports, fit.parameters
    return FoundEffect(
        id_, ports.get(id_, ""), "free_form" if over else "catalogue", tuple(known[n] for n in names if n in known),
        *table.share_of_term(decision.model, id_), claim.kind if claim is not None else None,
        tuple(Alternative(o, ports.get(o, ""), ratio) for o, ratio in others), context.family.describe(id_),
        over=over, looks_like=_looks_like(table, decision, id_) if over else "", curve=curve,
        tried_all=claim is None or claim.tried_all,
    )  # fmt: skip


def _looks_like(table: Table, decision: Decision, curve: str) -> str:
    """The law at the port of a curve that does best in its place."""
    port = table.ports.get(curve)
    laws = (o for o in table.swaps(decision.model, curve) if o not in table.curves and table.ports.get(o) == port)
    return law_of(next(laws, ""))


def _learned(basis: CurveBasis, names: list[str], fit: Fit) -> LearnedCurve:
    """Return a curve at the fit, and how sure it is."""
    parameters, optimum = fit.calibration.parameters, fit.optimum
    columns = [parameters.index(name) for name in names]
    values = parameters.from_search(optimum.coordinates)
    heights, scale = values[columns], parameters.jacobian(values)[columns]
    inside = [k for k, j in enumerate(columns) if j in optimum.free]
    rows = [optimum.free.index(columns[k]) for k in inside]
    covariance = np.zeros((len(columns), len(columns)))
    covariance[np.ix_(inside, inside)] = optimum.covariance[np.ix_(rows, rows)]
    covariance *= np.outer(scale, scale)
    return basis.learned(heights, covariance)
