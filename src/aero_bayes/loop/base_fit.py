"""The first model at its best on the fitted readings: what every structure is compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.check.residual_tests import ResidualReport, check_residuals
from aero_bayes.data import noise_floors
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.diagnosis import Diagnosis
from aero_bayes.estimate.finished_fit import finished_fit
from aero_bayes.estimate.fit import MAX_OUTLIER_ROUNDS
from aero_bayes.estimate.global_search import GlobalSearch, GlobalSearchResult
from aero_bayes.estimate.initial_states import with_free_starts
from aero_bayes.estimate.interpolation import choose_interpolation
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.outliers import without_outliers
from aero_bayes.estimate.parameters import Parameter, ParameterSet, chosen_parameters
from aero_bayes.estimate.priors import Normal
from aero_bayes.estimate.recording_parameters import for_recordings
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.solver_difference import with_solver_difference
from aero_bayes.estimate.step_parameters import acts_in_steps, settle_blind, with_slope
from aero_bayes.loop.context import LoopContext
from aero_bayes.search.models import FittedModel, with_setting
from aero_bayes.simulation import Model
from aero_bayes.simulation.interface import StartTarget

Floors = Mapping[tuple[str, str], float]

#: Distance of an estimated initial value from its reading, in standard deviations, above which it may imitate a term.
MAX_READING_DEVIATIONS = 5.0


@dataclass(frozen=True, eq=False)
class BaseFit:
    """The first model, fitted to the recordings."""

    plain: Calibration
    fit: Optimum
    reports: tuple[ResidualReport, ...]
    floors: Floors
    start_warnings: tuple[str, ...]
    found: Fit
    diagnosis: Diagnosis

    @property
    def values(self) -> dict[str, float]:
        """SI values by name."""
        parameters = self.plain.parameters
        return dict(zip(parameters.names, parameters.from_search(self.fit.coordinates).tolist(), strict=True))

    def with_terms(
        self, context: LoopContext, model: Model, new: Sequence[Parameter], fixed: Mapping[str, float] | None = None
    ) -> Calibration:
        """The same recordings held against the model with terms; ``new`` are their parameters.

        The starts of states that the terms brought have a value in each recording."""
        moved = context.family.transfer(self.plain, model)
        own = for_recordings(ParameterSet(tuple(new)), model, context.recordings.fitted)
        return replace(moved, parameters=moved.parameters.extended(own.items)).with_fixed(fixed or {})


def fit_base_model(context: LoopContext, begin: Mapping[str, float] | None = None) -> BaseFit:
    """Fit the first model: led by the first readings, then with initial values that may be off them.

    ``begin`` holds SI values by name from which the fit begins, in place of those that the parameters declare."""
    context.progress("building models", 0.0)
    model = context.family.base_model()
    context.statistics.end_stage("models")
    context.progress("fitting the model as given", 0.05)
    close, fit = _fitted_without_outliers(context, context.calibrate(model, _shared(context, model)), begin or {})
    plain = replace(close, parameters=with_free_starts(close.parameters, close.data.experiments, close.model))
    if plain.parameters != close.parameters:
        fit = best_fit(context, plain, close.parameters.from_search(fit.coordinates), fit)
    floors = noise_floors([*context.recordings.train, *context.recordings.test], context.recordings.outputs)
    context.statistics.end_stage("base fit")
    found = _finished(context, plain, fit)
    found = replace(with_solver_difference(found, context.open), outcomes=dict(context.statistics.outcomes))
    return BaseFit(
        plain, fit, _reports(context, plain, fit, floors), floors, _start_warnings(close, plain, fit), found,
        found.diagnosis,
    )  # fmt: skip


def _finished(context: LoopContext, plain: Calibration, fit: Optimum) -> Fit:
    with context.open(plain.problem()) as simulator:
        search = GlobalSearch(context.objective(plain, simulator), context.settings.global_search)
        return finished_fit(search, GlobalSearchResult(fit, None, (), 0), context.settings.fitting, 0.0)


def _fitted_without_outliers(
    context: LoopContext, calibration: Calibration, begin: Mapping[str, float]
) -> tuple[Calibration, Optimum]:
    """Fit what the data shows, and again without readings that are outliers of the fit, as long as there are any."""
    calibration, found = _fitted(context, calibration, begin)
    for _ in range(MAX_OUTLIER_ROUNDS):
        with context.open(calibration.problem()) as simulator:
            objective = context.objective(calibration, simulator)
            fitted = objective.predictions(objective.parameters.from_search(found.coordinates))
        cleaned, findings = without_outliers(calibration.data, fitted)
        if not findings:
            break
        calibration = replace(calibration, data=cleaned)
        found = best_fit(context, calibration, calibration.parameters.from_search(found.coordinates), found)
    return calibration, found


def refit_base(context: LoopContext, base: BaseFit, found: FittedModel) -> BaseFit:
    """The first model as the search read and freed it, from where the search found its optimum."""
    plain, own = with_setting(base.plain, base.fit.free, found.structure)
    values = np.array([found.values[name] for name in plain.parameters.names])
    fit = best_fit(context, plain, values, replace(base.fit, free=own, noise=base.fit.noise))
    if plain is base.plain and fit.log_likelihood + fit.log_prior <= base.fit.log_likelihood + base.fit.log_prior:
        return base
    told = _finished(context, plain, fit)
    return replace(base, plain=plain, fit=fit, reports=_reports(context, plain, fit, base.floors), found=told)


def best_fit(context: LoopContext, calibration: Calibration, values: FloatArray, last: Optimum) -> Optimum:
    """The optimum near SI values, under the objective of ``fit``: sensor noise, or least squares where structure is
    left."""
    with context.open(calibration.problem()) as simulator:
        objective = context.objective(calibration, simulator)
        found = GlobalSearch(objective, context.settings.global_search).refit(
            objective.parameters.to_search(values), last.free, last.noise
        )
        context.statistics.add_simulations(objective)
    return found


def _reports(context: LoopContext, plain: Calibration, fit: Optimum, floors: Floors) -> tuple[ResidualReport, ...]:
    with context.open(plain.problem()) as simulator:
        return check_residuals(plain, context.objective(plain, simulator).series, fit, floors)


def _shared(context: LoopContext, model: Model) -> ParameterSet:
    known, chosen = context.family.overrides(model), context.settings.parameters
    if chosen is None:
        chosen = tuple(name for name, override in known.items() if not override.free_if_identified)
    return chosen_parameters(model, chosen, known)


def _fitted(context: LoopContext, calibration: Calibration, begin: Mapping[str, float]) -> tuple[Calibration, Optimum]:
    """Fit what the data shows."""
    settings = context.settings
    with context.open(calibration.problem()) as simulator:
        objective = context.objective(calibration, simulator)
        search = GlobalSearch(objective, settings.global_search)
        rng = np.random.default_rng(context.seed)
        first = np.array([begin.get(p.name, p.start) for p in objective.parameters])
        start = objective.parameters.to_search(first)
        found_fit = search.run(_columns_with_effect(objective), context.open, rng, start=start)
        calibration, found = _without_steps(search, found_fit.optimum)
        if calibration is not objective.calibration:
            objective = objective.with_calibration(calibration, simulator)
            search = GlobalSearch(objective, settings.global_search)
            found = search.refit(found.coordinates, found.free, found.noise)
            found_fit = replace(found_fit, optimum=found)
        lines = (
            choose_interpolation(search, found_fit, context.open, rng)
            if settings.fitting.calibration.interpolation == "auto"
            else None
        )
        context.statistics.add_simulations(objective)
    return lines if lines is not None else (calibration, found)


def _columns_with_effect(objective: Objective) -> tuple[int, ...]:
    """Columns that change a recorded output at all, of those that are decided on."""
    every = tuple(j for j, p in enumerate(objective.parameters) if not p.free_if_identified)
    found = objective.evaluate(objective.parameters.to_search(objective.parameters.start), every)
    if found is None or found.slopes is None:
        return every
    felt = with_slope(found.slopes)
    point = objective.parameters.to_search(objective.parameters.start)
    return tuple(j for j, own in zip(every, felt, strict=True) if own or acts_in_steps(objective, point, j))


def _without_steps(search: GlobalSearch, found: Optimum) -> tuple[Calibration, Optimum]:
    """Hold parameters without a slope at what the search found for them: no later fit could move them."""
    objective = search.objective
    slopes = found.evaluation.slopes
    blind = [j for j, own in zip(found.free, with_slope(slopes), strict=True) if not own] if slopes else []
    if not blind or len(blind) == len(found.free):
        return objective.calibration, found
    point, _ = settle_blind(objective, found, blind)
    parameters = objective.parameters
    start = parameters.start
    start[blind] = parameters.from_search(point)[blind]
    held = replace(objective.calibration, parameters=parameters.with_start(start))
    return held, replace(found, coordinates=point, free=tuple(j for j in found.free if j not in blind))


def _start_warnings(close: Calibration, plain: Calibration, fit: Optimum) -> tuple[str, ...]:
    """Initial values that are far off their readings: they may imitate what is missing."""
    warnings = []
    values = plain.parameters.from_search(fit.coordinates)
    for p, value in zip(close.parameters, values.tolist(), strict=True):
        if isinstance(p.target, StartTarget) and isinstance(p.prior, Normal):
            off = abs(value - p.prior.mean) / p.prior.sd
            if off > MAX_READING_DEVIATIONS:
                warnings.append(
                    f"The initial value {p.name} is {value:.3g}, {off:.0f} standard deviations from its reading. It "
                    "may compensate for a missing effect."
                )
    return tuple(warnings)
