"""From recordings to a fitted model: particle swarm, then bounded local search with the noise estimated alongside."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from aero_bayes.arguments import require_all, require_type
from aero_bayes.checkpoint import Checkpoint
from aero_bayes.data.recording import Recording
from aero_bayes.declared import DeclaredParameter
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibrated_model import ValueCombination, combinations, compiled, split_values
from aero_bayes.estimate.calibration import Calibration, calibrate
from aero_bayes.estimate.data_hypotheses import with_misread_finding
from aero_bayes.estimate.exports import ValueTrial
from aero_bayes.estimate.feedback import with_feedback
from aero_bayes.estimate.finished_fit import finished_fit, with_identified
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.held_starts import with_start_finding
from aero_bayes.estimate.held_values import with_held_beside
from aero_bayes.estimate.initial_states import mended_recordings
from aero_bayes.estimate.input_noise import with_input_noise
from aero_bayes.estimate.interpolation import choose_interpolation
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.local_fit import OpenSimulator, Optimum
from aero_bayes.estimate.modes import Mode, find_modes, likelihood_temperature
from aero_bayes.estimate.noise_estimation import describe_sensors
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.other_reading import Refits
from aero_bayes.estimate.outliers import choose_spreads, is_correlated, refit_with_spread, without_outliers
from aero_bayes.estimate.parameters import ChosenParameters, ParameterSet, ParameterSpec, chosen_parameters
from aero_bayes.estimate.priors import LogNormal
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.simulation_error import sharper_model, with_simulation_error
from aero_bayes.estimate.swarm import SwarmResult
from aero_bayes.parallel import ParallelMap, Task
from aero_bayes.progress import Progress, Watched, watching
from aero_bayes.simulation.interface import Outcome, Problem, Simulator
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool


def declared_overrides(model: Model) -> dict[str, ParameterSpec]:
    """Return priors, starts and bounds of the declared parameters that a model has; nothing for a model without any."""
    own = {v.name: v.start for v in model.parameters}
    declared = model.declared.parameters
    return {name: _override(name, start, declared[name]) for name in declared if (start := own.get(name)) is not None}


def _override(name: str, start: float, known: DeclaredParameter) -> ParameterSpec:
    """Set bounds a factor below the smaller and above the larger of start and prior median."""
    if start <= 0.0:
        raise InputError(
            f"{name}: its declared prior is log-normal, and the model's own value {start:g} is not positive"
        )
    median = start if known.median is None else known.median
    if known.relative_sd is not None:
        prior = LogNormal.tolerance(median, known.relative_sd)
    else:
        prior = LogNormal.factor(median, known.factor)
    low, high = min(start, prior.median), max(start, prior.median)
    return ParameterSpec(start, low / known.reach, high * known.reach, prior, "log", known.auto)


R = TypeVar("R")
#: How often a fit is repeated without its outliers: the first one is drawn by them, so that it may not see all.
MAX_OUTLIER_ROUNDS = 3


def fit(
    recordings: Recording | Sequence[Recording],
    model: Model,
    *,
    parameters: ChosenParameters | None = None,
    settings: FitSettings | None = None,
    seed: int = 1,
    workers: int | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | Path | str | None = None,
    explain: bool = True,
) -> Fit:
    """Fit a model to recordings.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
    model : Model
    parameters : sequence of str, mapping or ParameterSet, optional
        What to search: names; or by name bounds ``(lower, upper)``, a value to start from, a prior, an
        :class:`ParameterSpec`, or ``{"values": [1, 2, 3]}``, each of which is fitted. By default what the
        model's package declares.
    settings : FitSettings, optional
    seed : int
    workers : int, optional
        Worker processes; all cores by default.
    progress : callable, optional
        Told a phase, how far it is (0 to 1), and the cost; where it returns True, the fit ends with its best values so
        far, and says so. By default a bar in a notebook, where an interrupt ends it likewise.
    checkpoint : Checkpoint or path, optional
        File to resume from and to keep up to date.
    explain : bool
        Whether to ask what else than the model may be behind what is left, such as a channel that was read wrongly. Of
        a poor fit that takes about as long as the fit.

    Returns
    -------
    Fit
        Values with intervals, the noise, the residuals and a diagnosis.

    Raises
    ------
    InputError
        If the recordings and the model do not belong together.
    CannotFinishError
        If the model cannot be simulated at any starting point.

    Examples
    --------
    >>> aero_bayes.fit(recording, model, parameters=["k", "d"], workers=0)
    <Fit Rig: k=54.9 N/m, d=3.899 N.s/m>
    """
    recordings = require_all(recordings, Recording, "recordings")
    require_type(model, Model, "model")
    require_type(settings or FitSettings(), FitSettings, "settings")
    require_type(seed, int, "seed")
    # Sums over BLAS threads differ in their last digits, and the same seed is to give the same numbers.
    with threadpool_limits(limits=1, user_api="blas"), watching(progress) as watched:
        cache = Checkpoint.at(checkpoint)
        request = _Request(model, parameters, settings or FitSettings(), seed, workers, watched, cache)
        found = request.finished(mended_recordings(recordings, model))
        return request.explained(found) if explain and not watched.asked_to_end else found


class _Request:
    """What the fits of one call share: the model, the parameters to search, the settings and the seed."""

    def __init__(
        self,
        model: Model,
        parameters: ChosenParameters | None,
        settings: FitSettings,
        seed: int,
        workers: int | None,
        progress: Watched,
        cache: Checkpoint | None,
    ) -> None:
        self.settings, self.seed, self.workers, self.progress, self.cache = settings, seed, workers, progress, cache
        self.overrides = declared_overrides(model)
        chosen = parameters if parameters is not None else tuple(self.overrides)
        if isinstance(chosen, Sized) and not chosen and not isinstance(chosen, ParameterSet):
            known = ", ".join(v.name for v in model.parameters)
            raise InputError(
                f"model {model.name} declares no parameters to fit: say which to search by parameters; it has {known}"
            )
        if settings.noise.process and settings.cost != "posterior":
            raise InputError(f"cost = {settings.cost!r} knows no process noise: it needs cost = 'posterior'")
        self.chosen, listed = split_values(chosen)
        self.candidates = combinations(model, {**settings.values, **listed})

    def opened(self, problem: Problem, workers: int | None = None, pool: WorkerPool | None = None) -> Simulator:
        """Open a simulator of a problem."""
        from aero_bayes.simulation.engines import open_simulator

        count = self.workers if workers is None else workers
        return open_simulator(problem, count, pool)

    def calibration(self, recordings: Sequence[Recording], model: Model, fixed: Mapping[str, float]) -> Calibration:
        """Combine recordings and a model."""
        free, settings = chosen_parameters(model, self.chosen, self.overrides), self.settings
        return calibrate(recordings, model, free, fixed=fixed, noise=settings.noise, settings=settings.calibration)

    def explained(self, found: Fit) -> Fit:
        """Return a fit with what else than the model may be behind what it leaves."""
        with WorkerPool(0) as pool:  # one run needs no workers, and the model is unpacked once for all
            return self._told(found, partial(self.opened, pool=pool))

    def _told(self, found: Fit, here: OpenSimulator) -> Fit:
        problem = found.calibration
        calibrated = partial(self.calibration, model=problem.model, fixed=problem.fixed)
        refits = Refits(calibrated, self.fitted_again, here, self.each_fitted)
        told = with_start_finding(found, refits)
        # A wrong start looks like a constant at a reading, too.
        told = with_misread_finding(found, refits) if told is found else told
        told = with_feedback(found, here) if told is found else told
        return with_input_noise(found, here) if told is found else told

    def fitted_again(self, other: Calibration, workers: int | None = None) -> Fit:
        """Fit another calibration by a local search."""
        local, opened = replace(self.settings, method="local"), partial(self.opened, workers=workers)
        return fit_calibration(other, opened, local, np.random.default_rng(self.seed))

    def each_fitted(
        self, calibrations: Sequence[Calibration], chosen: Callable[[Calibration], bool], told: Callable[[Fit], R]
    ) -> Iterable[R | None]:
        """What is told of the fit of each chosen calibration, else None: side by side, or one by one when asked."""

        def one(calibration: Calibration, workers: int | None) -> R | None:
            with suppress(CannotFinishError):
                return told(self.fitted_again(calibration, workers)) if chosen(calibration) else None
            return None

        with WorkerPool(self.workers) as pool:
            if pool.size < 2:
                return (one(calibration, None) for calibration in calibrations)
            return ParallelMap(pool)([Task(partial(one, calibration, 1)) for calibration in calibrations])

    def finished(self, recordings: Sequence[Recording]) -> Fit:
        """Fit, with what the solver and values that are held add to its intervals."""
        found, here = self.alone(recordings), partial(self.opened, workers=0)
        return with_held_beside(with_simulation_error(found, here, sharper_model(found.calibration.model)), here)

    def alone(self, recordings: Sequence[Recording]) -> Fit:
        """Fit each combination of listed values, and finish the likeliest: outliers, sensors, noise."""
        settings, opened, watched, cache = self.settings, self.opened, self.progress, self.cache

        def fitted(candidate: ValueCombination) -> Fit:
            calibration = self.calibration(recordings, candidate.model, {**settings.fixed, **candidate.fixed})
            rng = np.random.default_rng(self.seed)
            return fit_calibration(calibration, opened, settings, rng, watched, checkpoint=cache)

        # Outliers and kinds of noise belong to the likeliest values: all are compared on the same readings.
        found = _likeliest(self.candidates, fitted)
        filtered = found.calibration.process is not None
        if not filtered and not watched.asked_to_end:
            found = _without_outliers(found, opened, settings, watched, cache)
        if settings.cost == "posterior" and not filtered and not watched.asked_to_end:
            found = _with_noise_kinds(_with_sensors(found), opened, settings, watched)
        return found


def _likeliest(candidates: Sequence[ValueCombination], fitted: Callable[[ValueCombination], Fit]) -> Fit:
    """Return the fit with the likeliest values, with how much worse the others are.

    The fit itself where nothing is listed."""
    if len(candidates) == 1 and not candidates[0].values:
        return fitted(candidates[0])
    fits: list[tuple[ValueCombination, Fit]] = []
    failed: list[ValueTrial] = []
    last: Exception | None = None
    for candidate in candidates:
        try:
            fits.append((candidate, fitted(compiled(candidate))))
        except (CannotFinishError, InputError) as error:
            failed.append(ValueTrial(candidate.values, candidate.numbers, candidate.modifiers, failed=str(error)))
            last = error
    if not fits:
        assert last is not None
        raise last
    fits.sort(key=lambda pair: -pair[1].log_posterior)
    best = fits[0][1]
    worse = np.array([best.log_posterior - fit.log_posterior for _, fit in fits])
    weights = np.exp(-worse / likelihood_temperature(best.optimum))
    trials = [
        ValueTrial(c.values, c.numbers, c.modifiers, float(share), float(w))
        for (c, _), share, w in zip(fits, weights / weights.sum(), worse, strict=True)
    ]
    return replace(best, trials=(*trials, *failed))


def _without_outliers(
    found: Fit, opened: OpenSimulator, settings: FitSettings, progress: Progress | None, cache: Checkpoint | None
) -> Fit:
    """Fit again without readings that are outliers of the fit, as long as there are any.

    An outlier is what a good fit leaves alone: of an output whose residual stays structured, all readings are kept."""
    first, poor = found, frozenset[str]()
    while True:
        removed: set[str] = set()
        for _ in range(MAX_OUTLIER_ROUNDS):
            data, findings = without_outliers(found.calibration.data, found.fitted, poor)
            if not findings:
                break
            removed |= {finding.signal for finding in findings}
            cleaned = replace(found.calibration, data=data)
            with opened(cleaned.problem()) as simulator:
                objective = objective_of(cleaned, simulator, result_cache=cache)
                search, start = GlobalSearch(objective, settings, progress), cleaned.parameters.to_search(found.values)
                found = _continued(found, search, search.refit(start, found.free, found.noise))
        structured = {o for o in removed if found.noise[o].model_error or is_correlated(found.series, found.optimum, o)}
        if not structured:
            return found
        found, poor = first, poor | structured


def _with_sensors(found: Fit) -> Fit:
    """Describe the encoders among the sensors of a fit."""
    data = found.calibration.data
    rows = [(e.time, y, f) for e, y, f in zip(data.experiments, data.readings, found.fitted, strict=True)]
    return replace(found, sensors=describe_sensors(found.outputs, rows))


def _with_noise_kinds(first: Fit, opened: OpenSimulator, settings: FitSettings, progress: Progress | None) -> Fit:
    """Fit again under noise that differs from reading to reading, where the data show such noise or it is declared."""
    models = choose_spreads(first.calibration.noise, first.series, first.optimum)
    if not models:
        return first
    began = time.perf_counter()
    with opened(first.calibration.problem()) as simulator:
        objective = objective_of(first.calibration, simulator)
        found = refit_with_spread(GlobalSearch(objective, settings, progress), first.optimum, models)
        if found is None:
            return first
        again = _continued(first, *found)
    return replace(again, seconds=first.seconds + time.perf_counter() - began, sensors=first.sensors)


def _continued(first: Fit, search: GlobalSearch, optimum: Optimum) -> Fit:
    """Return the fit at the optimum of a refit, with the work of the first fit counted in."""
    again = finished_fit(search, optimum, first.seconds, first)
    return replace(
        again,
        modes=first.modes,
        trials=first.trials,
        iterations=first.iterations + search.iterations,
        outcomes={o: again.outcomes.get(o, 0) + first.outcomes.get(o, 0) for o in Outcome},
    )


def fit_calibration(
    calibration: Calibration,
    open_simulator: OpenSimulator,
    settings: FitSettings | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    *,
    checkpoint: Checkpoint | None = None,
) -> Fit:
    """Fit a calibration through any simulator."""
    settings, rng = settings or FitSettings(), rng if rng is not None else np.random.default_rng(1)
    began = time.perf_counter()
    with ExitStack() as stack:
        # Simulations occupy every core; BLAS threads for matrices of a dozen rows would only fight them for it.
        stack.enter_context(threadpool_limits(limits=1, user_api="blas"))
        simulator = stack.enter_context(open_simulator(calibration.problem()))
        first = search = GlobalSearch(objective_of(calibration, simulator, result_cache=checkpoint), settings, progress)
        free = tuple(j for j, p in enumerate(calibration.parameters) if not p.free_if_identified)
        here = search.run(free, open_simulator, rng)
        chosen = settings.calibration.interpolation == "auto" and not search.progress.asked_to_end
        linear = choose_interpolation(search, here, open_simulator, rng) if chosen else None
        if linear is not None:
            simulator = stack.enter_context(open_simulator(linear[0].problem()))
            search = GlobalSearch(search.objective.with_calibration(linear[0], simulator), settings)
            here = search.refit(linear[1].coordinates, free, linear[1].noise)
        wider = with_identified(search.objective, here)
        if wider != free:
            here = search.refit(here.coordinates, wider, here.noise)
            first.iterations = search.iterations
        found = finished_fit(search, here, time.perf_counter() - began, first)
        swarm = first.swarm if found.free == here.free else None
        return found if settings.method != "pso+local" else replace(found, modes=_modes(search, found, swarm))


def _modes(search: GlobalSearch, found: Fit, swarm: SwarmResult | None) -> tuple[Mode, ...]:
    """Find other optima that fit as well, where the cost is a posterior and no filter's."""
    if search.settings.cost != "posterior" or search.objective.filters or search.progress.asked_to_end:
        return ()
    return find_modes(search, found.optimum, swarm)
