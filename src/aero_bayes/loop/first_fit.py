"""The first model at its best on the fitted readings: what every structure is compared with."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from aero_bayes.arguments import Count, Positive, names_of
from aero_bayes.arrays import FloatArray
from aero_bayes.data.noise_floor import noise_floors
from aero_bayes.data.split import Recordings
from aero_bayes.display import SettingsDisplay
from aero_bayes.estimate.calibration import Calibration, calibrate, for_recordings
from aero_bayes.estimate.finished_fit import finished_fit
from aero_bayes.estimate.fit import declared_overrides, fit
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.held_values import with_held_beside
from aero_bayes.estimate.initial_states import with_free_starts
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.local_fit import GOOD_FIT_RATIO, Optimum
from aero_bayes.estimate.measured_data import readings_of
from aero_bayes.estimate.noise import NoiseModel, residual_correlation_time
from aero_bayes.estimate.objective import Objective, Series, Whitened, objective_of
from aero_bayes.estimate.parameters import ChosenParameters, Parameter, ParameterSet, chosen_parameters
from aero_bayes.estimate.predict_recordings import Predictor
from aero_bayes.estimate.residual_tests import ResidualReport, check_residuals, structured_residuals
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.parallel import ParallelMap
from aero_bayes.progress import Watched
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, Outcome, Problem, Simulator, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool


@dataclass(frozen=True, repr=False)
class LoopSettings(SettingsDisplay):
    """Settings of the closed loop.

    Parameters
    ----------
    fit : FitSettings, optional
        How the first model and the extended one are fitted; by default as the fit was that is given, else by a local
        search.
    parameters : sequence of str, mapping or ParameterSet, optional
        What is fitted of the first model, as for :func:`aero_bayes.fit`; by default what the given fit found free, else
        what the model's package declares to be searched. The others may be found to have a wrong value.
    solver : SolverSettings
        Of the simulations of the loop, which compares models: it is coarser than that of a fit.
    most_readings : int
        Readings of an output that a recording keeps; beyond it every n-th is kept.
    effects : tuple of str, optional
        Ids or laws that are tried; all by default.
    exclude : tuple of str
        Ids, ports or laws that are not tried.
    require : tuple of str
        Ids of terms that have to be in the model.
    ports, laws : tuple of str, optional
        The only ports and laws that are tried; all by default.
    max_effects : int
        Terms that are added at most.
    held_out : float
        Last share of each recording that is not fitted, if no other recording is given: its first half validates, its
        second half is the test part.
    cache : Path, optional
        Folder of FMUs that are kept between runs; by default ``fmu`` in the folder of the run, removed at the end.
    max_minutes : float
        Time limit of the search; the loop continues with what was found by then, and says so.
    max_error_ratio : float
        Largest ratio of the error on data that was not fitted to that of the fit for a model to count as adequate.

    Examples
    --------
    >>> settings = aero_bayes.LoopSettings(parameters=("k", "d"), exclude=("F",))
    >>> settings.fitting.calibration.most_readings
    8000
    >>> settings
    LoopSettings(parameters=('k', 'd'), exclude=('F',))
    """

    fit: FitSettings | None = None
    parameters: ChosenParameters | None = None
    solver: SolverSettings = field(default_factory=lambda: SolverSettings(1e-5, 1e-5))
    most_readings: int = 8000
    effects: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()
    require: tuple[str, ...] = ()
    ports: tuple[str, ...] | None = None
    laws: tuple[str, ...] | None = None
    max_effects: Count = 3
    held_out: Annotated[float, Field(gt=0, lt=0.9)] = 0.3
    cache: Path | None = None
    max_minutes: Positive = 20.0
    max_error_ratio: float = 3.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "cache", None if self.cache is None else Path(self.cache))
        for name in ("effects", "exclude", "require", "ports", "laws"):
            given = getattr(self, name)
            object.__setattr__(self, name, given if given is None else names_of(given, name))

    @property
    def fitting(self) -> FitSettings:
        """How models are fitted in the loop: with its solver, and of a counter at standstill few readings only."""
        fit = self.fit or FitSettings(method="local")
        calibration = replace(
            fit.calibration, most_readings=self.most_readings, keep_standstill_readings=False, solver=self.solver
        )
        return replace(fit, calibration=calibration)


#: Shares of a loop's progress at which the first fit ends, and the search.
FITTED_FIRST, SEARCHED = 0.1, 0.9


class LoopStatistics:
    """Time spent in each stage, the time limit, and counts of simulations; the only part of a loop that changes.

    The search ends early where the progress that is ``watched`` is asked to end. How far it is follows from its work
    or from its time limit, whichever is further."""

    def __init__(self, watched: Watched | None = None) -> None:
        self.watched = watched or Watched()
        self.seconds: dict[str, float] = {}
        self.outcomes: Counter[Outcome] = Counter()
        self._clock = time.perf_counter()
        self._until, self._limit = math.inf, math.inf
        self._told = ("", 0.0)

    def tell(self, what: str, share: float) -> bool:
        """Tell what is done and how far the loop is, which never falls; True where it is asked to end."""
        self._told = what, max(share, self._told[1])
        return self.watched(*self._told)

    def tell_search(self, what: str, done: float) -> object:
        """Tell what a search does, and which share of it is done."""
        return self.tell(what, FITTED_FIRST + (SEARCHED - FITTED_FIRST) * done)

    def set_time_limit(self, seconds: float) -> None:
        """Limit the time from now on, in s. What follows takes about as long as what came before: it fits, too."""
        self._until, self._limit = time.perf_counter() + seconds, seconds
        self.watched.ends_within(seconds + sum(self.seconds.values()))

    def end_search(self) -> None:
        """Tell that the search is over, and end its stage."""
        self.watched.ends_within(sum(self.seconds.values()))
        self.end_stage("search")

    def used(self) -> float:
        """Share of the time limit that has passed."""
        return 1.0 - (self._until - time.perf_counter()) / self._limit if self._limit < math.inf else 0.0

    def time_is_up(self) -> bool:
        """Whether the time limit has passed, or the search is asked to end."""
        used = self.used()
        share = FITTED_FIRST + (SEARCHED - FITTED_FIRST) * min(used, 1.0)
        return self.tell(self._told[0], share if used > 0.0 else 0.0) or used > 1.0

    def end_stage(self, stage: str) -> None:
        """Add the time since the last stage ended to this stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._clock
        self._clock = now


@dataclass(frozen=True, eq=False)
class LoopContext:
    """What all stages of a loop share.

    ``folder`` is where the extended model is written."""

    family: ModelicaFamily
    recordings: Recordings
    settings: LoopSettings
    pool: WorkerPool
    folder: Path
    statistics: LoopStatistics
    seed: int = 1

    def open(self, problem: Problem) -> Simulator:
        """A simulator on the loop's workers."""
        return open_simulator(problem, pool=self.pool)

    def objective(self, calibration: Calibration, simulator: Simulator | None = None) -> Objective:
        """A calibration on a simulator, or on one of its own, which the caller closes; its simulations are counted."""
        found = objective_of(calibration, simulator or self.open(calibration.problem()))
        found.outcomes = self.statistics.outcomes
        return found

    @property
    def map(self) -> ParallelMap:
        """A map over independent fits, one process a worker; none is begun after the time limit."""
        return ParallelMap(self.pool, self.statistics.time_is_up)

    @property
    def predictor(self) -> Predictor:
        """The recordings whole, to run fitted models over."""
        return Predictor(self.recordings, self.family, self.open)


#: Rows on which a search takes a minute: of recordings of twice that length and more only a beginning is searched. It
#: tells at least this share of what the whole tells, reading by reading.
FIRST_ROWS, MIN_INFORMATION = 4000, 0.5
#: Effective sample size of what is left of each output in a beginning that only spares time: ten readings in each of
#: twenty blocks, or folds would ask for interpolation. In 4,000 rows EMPS, which drifts, has one, the silverbox 1,400.
MIN_INDEPENDENT = 200.0


@dataclass(frozen=True, eq=False)
class FirstFit:
    """The first model fitted to the recordings; ``plain`` is its calibration, its parameters at declared values."""

    plain: Calibration
    fit: Fit
    reports: tuple[ResidualReport, ...]
    floors: Mapping[tuple[str, str], float]

    @property
    def values(self) -> dict[str, float]:
        """SI values by name."""
        return dict(zip(self.plain.parameters.names, self.fit.values.tolist(), strict=True))

    def with_terms(self, context: LoopContext, model: Model, new: Sequence[Parameter]) -> Calibration:
        """The same recordings held against the model with terms; ``new`` are their parameters.

        The starts of states that the terms brought have a value in each recording."""
        moved, new = context.family.transfer(self.plain, model), context.family.starts_on(new, self.plain.model, model)
        old = set(moved.parameters.names)
        own = for_recordings(ParameterSet(tuple(p for p in new if p.name not in old)), model, context.recordings.fitted)
        freed = {p.name for p in new}
        items = tuple(
            replace(p, free_if_identified=p.free_if_identified and p.name not in freed) for p in moved.parameters
        )
        fixed = {n: v for n, v in moved.fixed.items() if n not in freed}
        return replace(moved, fixed=fixed, parameters=ParameterSet(items).extended(own.items))


def first_fit(context: LoopContext, given: Fit | None = None) -> FirstFit:
    """Fit the first model: led by the first readings, then with initial values that may be off them.

    A fit that is ``given`` is the first of both, but where it left out some of the outputs."""
    context.statistics.tell("building models", 0.0)
    model, recordings, settings = context.family.base_model(), context.recordings, context.settings
    context.statistics.end_stage("models")
    fitting = "fitting the model as given"
    context.statistics.tell(fitting, 0.01)
    declared, own = _chosen(context, model), settings.fitting
    own = replace(
        own,
        calibration=replace(own.calibration, outputs=recordings.outputs),
        noise=NoiseModel(sd=own.noise.sd, initial_sd=own.noise.initial_sd),
    )

    def told(phase: str, share: float, *value: object) -> None:
        context.statistics.tell(fitting, FITTED_FIRST * share)

    def fitted(method: str) -> Fit:
        how = replace(own, method=method)  # type: ignore[arg-type]
        return fit(
            recordings.fitted, model, parameters=declared, settings=how, seed=context.seed, workers=context.pool.size,
            progress=Watched(told),
        )  # fmt: skip

    floors = noise_floors(recordings.everything, recordings.outputs)
    given = given if given is not None and given.outputs == recordings.outputs else None
    close = given or fitted("local")
    reports = check_residuals(close.calibration, close.series, close.optimum, floors)
    if given is None and own.method != "local" and max(r.over_noise for r in reports) > GOOD_FIT_RATIO:
        close = fitted(own.method)
        reports = check_residuals(close.calibration, close.series, close.optimum, floors)
    calibration = close.calibration if given is None else _as_fitted(context, declared, given, own)
    data, again = calibration.data, with_free_starts(calibration.parameters, calibration.data.experiments, model)
    # All structures are compared under one noise, each reading of an output alike, unless nothing is left to explain.
    if structured_residuals(reports):
        data = replace(data.with_experiments(replace(e, spread=None) for e in data.experiments), spreads={})
    plain, found = replace(calibration, parameters=again, data=data, noise=own.noise), close
    moved = any(a.prior != b.prior for a, b in zip(plain.parameters, calibration.parameters, strict=True))
    if given is not None or moved or calibration.data.spreads:
        values = dict(zip(close.calibration.parameters.names, close.values.tolist(), strict=True))
        si = np.array([values.get(p.name, p.start) for p in plain.parameters])
        free = close.free if given is None else tuple(j for j, p in enumerate(again) if not p.free_if_identified)
        found = refitted(context, plain, si, replace(close.optimum, free=free))
        found = replace(found, sensors=close.sensors, solver_difference=close.solver_difference)
    if given is None:
        context.statistics.outcomes.update(close.outcomes)
        found = replace(found, outcomes=close.outcomes)
    context.statistics.end_stage("first fit")
    reports = check_residuals(plain, found.series, found.optimum, floors)
    return FirstFit(plain, found, reports, floors)


def _as_fitted(context: LoopContext, declared: ParameterSet, given: Fit, how: FitSettings) -> Calibration:
    """Return the recordings of the loop as a fit read them: its inputs between samples, its noise, and no outliers."""
    own = replace(how.calibration, interpolation=given.calibration.data.interpolation)
    calibration = calibrate(
        context.recordings.fitted, context.family.base_model(), declared, fixed=how.fixed, noise=how.noise, settings=own
    )
    experiments = []
    for e, known in zip(calibration.data.experiments, given.calibration.data.experiments, strict=True):
        rows = np.minimum(np.searchsorted(known.time, e.time), known.time.size - 1)
        left_out = (known.time[rows] == e.time)[:, None] & np.isnan(readings_of(known)[rows])
        measured = np.where(left_out, np.nan, readings_of(e))
        spread = None if known.spread is None else known.spread[rows]
        experiments.append(replace(e, inputs=known.inputs, measured=measured, spread=spread))
    data = replace(calibration.data.with_experiments(experiments), spreads=given.calibration.data.spreads)
    return replace(calibration, data=data, settings=how.calibration)


def _chosen(context: LoopContext, model: Model) -> ParameterSet:
    """What is fitted of the first model."""
    known, chosen = declared_overrides(model), context.settings.parameters
    if chosen is None:
        chosen = tuple(name for name, override in known.items() if not override.free_if_identified)
    return chosen_parameters(model, chosen, known)


def refitted(
    context: LoopContext, calibration: Calibration, values: FloatArray, like: Optimum, *, hold_noise: bool = False
) -> Fit:
    """The fit of a calibration from SI values (p,), under the objective of ``fit``; free is what is so in ``like``.

    The noise begins at that of ``like``, or is held there."""
    began = time.perf_counter()
    with context.open(calibration.problem()) as simulator:
        objective = context.objective(calibration, simulator)
        search = GlobalSearch(objective, context.settings.fitting)
        point = objective.parameters.to_search(values)
        end = search.refit(point, like.free, like.noise, hold_noise=hold_noise)
        found = finished_fit(search, end, time.perf_counter() - began)
    return with_held_beside(found, context.open)


def beginning_share(
    experiments: Sequence[Experiment], series: Sequence[Series], fitted: Whitened, residuals: Sequence[FloatArray]
) -> float:
    """The share of each recording, from its beginning, on which structures are searched for; 1 for the whole.

    It is less only where a recording is very long, and tells half as much, reading by reading, of each parameter and of
    what is missing as the whole does. Of one whose readings alone are not so many, the rows of its inputs count, since
    a run takes a step for each; there what the fit leaves (``residuals``, one a series) needs enough readings that do
    not hang on each other."""
    rows = [e.time.size for e in experiments]
    squares = np.vstack([fitted.slopes**2, fitted.residual**2])
    whole = squares.mean(axis=1)
    independent = min(r.size / residual_correlation_time([r]) for r in residuals)

    def share_of(longest: int, least: float) -> float:
        first = FIRST_ROWS
        while 2 * first < longest:
            inside = np.concatenate([s.sampling.index < first / longest * rows[s.experiment] for s in series])
            alike = inside.any() and np.all(squares[:, inside].mean(axis=1) >= MIN_INFORMATION * whole)
            if alike and first / longest * independent >= least:
                return first / longest
            first *= 2
        return 1.0

    share = share_of(max(rows), 0.0)
    steps = max((s.time.size for e in experiments for s in e.inputs), default=0)
    return share if share < 1.0 else share_of(steps, MIN_INDEPENDENT)
