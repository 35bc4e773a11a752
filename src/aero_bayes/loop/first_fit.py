"""The first model at its best on the fitted readings: what every structure is compared with."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.check.residual_tests import ResidualReport, check_residuals
from aero_bayes.data import noise_floors
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.finished_fit import finished_fit
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.global_search import GlobalSearch, GlobalSearchResult
from aero_bayes.estimate.initial_states import with_free_starts
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Series, Whitened
from aero_bayes.estimate.parameters import Parameter, ParameterSet, chosen_parameters
from aero_bayes.estimate.progressive_horizon import GOOD_FIT_RATIO
from aero_bayes.estimate.recording_parameters import for_recordings
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.context import LoopContext
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.simulation import Model

#: Rows on which a search takes a minute: of recordings of twice that length and more only a beginning is searched. It
#: tells at least this share of what the whole tells, reading by reading.
FIRST_ROWS, MIN_INFORMATION = 25_000, 0.5


@dataclass(frozen=True, eq=False)
class FirstFit:
    """The first model fitted to the recordings; ``plain`` is its calibration, its parameters at declared values."""

    plain: Calibration
    fit: Fit
    reports: tuple[ResidualReport, ...]
    floors: Mapping[tuple[str, str], float]

    @property
    def values(self) -> dict[str, float]:
        """SI values by name, also of those that the fit moved though no slope determines them."""
        found = self.fit.calibration.parameters.from_search(self.fit.optimum.coordinates)
        return dict(zip(self.plain.parameters.names, found.tolist(), strict=True))

    def with_terms(self, context: LoopContext, model: Model, new: Sequence[Parameter]) -> Calibration:
        """The same recordings held against the model with terms; ``new`` are their parameters.

        The starts of states that the terms brought have a value in each recording."""
        moved = context.family.transfer(self.plain, model)
        known = set(moved.parameters.names)
        own = for_recordings(
            ParameterSet(tuple(p for p in new if p.name not in known)), model, context.recordings.fitted
        )
        freed = {p.name for p in new}
        items = tuple(
            replace(p, free_if_identified=p.free_if_identified and p.name not in freed) for p in moved.parameters
        )
        fixed = {n: v for n, v in moved.simulated.fixed.items() if n not in freed}
        simulated = replace(moved.simulated, fixed=fixed)
        return replace(moved, simulated=simulated, parameters=ParameterSet(items).extended(own.items))


def first_fit(context: LoopContext, begin: Mapping[str, float]) -> FirstFit:
    """Fit the first model: led by the first readings, then with initial values that may be off them.

    ``begin`` holds SI values by name from which the fit begins, in place of those that the parameters declare."""
    context.progress("building models", 0.0)
    model, recordings, settings = context.family.base_model(), context.recordings, context.settings
    context.statistics.end_stage("models")
    context.progress("fitting the model as given", 0.05)
    declared = _chosen(context, model)
    starts = [float(np.clip(begin.get(p.name, p.start), p.lower, p.upper)) for p in declared]
    own = settings.fitting
    own = replace(
        own,
        calibration=replace(own.calibration, outputs=recordings.outputs),
        noise=NoiseModel(sd=own.noise.sd, initial_sd=own.noise.initial_sd),
    )

    def fitted(method: str) -> Fit:
        chosen = declared.with_start(np.array(starts))
        how = replace(own, method=method)  # type: ignore[arg-type]
        return fit(
            recordings.fitted, model, parameters=chosen, settings=how, seed=context.seed, workers=context.pool.size
        )

    floors = noise_floors([*recordings.train, *recordings.test], recordings.outputs)
    close = fitted("local")
    if own.method != "local":
        reports = check_residuals(close.calibration, close.series, close.optimum, floors)
        if max(r.ratio for r in reports) > GOOD_FIT_RATIO:
            close = fitted(own.method)
    context.statistics.outcomes.update(close.outcomes)
    calibration, named = close.calibration, {p.name: p.start for p in declared}
    again = calibration.parameters.with_start(np.array([named.get(p.name, p.start) for p in calibration.parameters]))
    again = with_free_starts(again, calibration.data.experiments, model)
    # All structures are compared under one noise, each reading of an output alike.
    alike = calibration.data.with_experiments(replace(e, spread=None) for e in calibration.data.experiments)
    plain, found = replace(calibration, parameters=again, data=replace(alike, spreads={}), noise=own.noise), close
    moved = any(a.prior != b.prior for a, b in zip(plain.parameters, calibration.parameters, strict=True))
    if moved or calibration.data.spreads:
        found = refitted(context, plain, close.values, replace(close.optimum, free=close.free))
        found = replace(
            found, sensors=close.sensors, solver_difference=close.solver_difference, outcomes=close.outcomes
        )
    context.statistics.end_stage("first fit")
    reports = check_residuals(plain, found.series, found.optimum, floors)
    return FirstFit(plain, found, reports, floors)


def _chosen(context: LoopContext, model: Model) -> ParameterSet:
    """What is fitted of the first model."""
    known, chosen = context.family.overrides(model), context.settings.parameters
    if chosen is None:
        chosen = tuple(name for name, override in known.items() if not override.free_if_identified)
    return chosen_parameters(model, chosen, known)


def refitted(context: LoopContext, calibration: Calibration, values: FloatArray, like: Optimum) -> Fit:
    """The fit of a calibration from SI values (p,), under the objective of ``fit``; free is what is so in ``like``."""
    began = time.perf_counter()
    with context.open(calibration.problem()) as simulator:
        objective = context.objective(calibration, simulator)
        search = GlobalSearch(objective, context.settings.fitting.global_search)
        end = search.refit(objective.parameters.to_search(values), like.free, like.noise)
        result = GlobalSearchResult(end, None, (), search.iterations)
        return finished_fit(search, result, context.settings.fitting, time.perf_counter() - began)


def beginning_share(rows: Sequence[int], series: Sequence[Series], fitted: Whitened) -> float:
    """The share of each recording, from its beginning, on which structures are searched for; 1 for the whole.

    It is less only where a recording is very long (``rows`` are their lengths), and tells half as much, reading by
    reading, of each parameter and of what is missing as the whole does."""
    first, longest = FIRST_ROWS, max(rows)
    squares = np.vstack([fitted.slopes**2, fitted.residual**2])
    whole = squares.mean(axis=1)
    while 2 * first < longest:
        inside = np.concatenate([s.sampling.index < first / longest * rows[s.experiment] for s in series])
        if inside.any() and np.all(squares[:, inside].mean(axis=1) >= MIN_INFORMATION * whole):
            return first / longest
        first *= 2
    return 1.0
