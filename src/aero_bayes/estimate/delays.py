"""What no local step finds: other optima of delays, and parameters without a slope, some of which act in steps.

And a cheaper problem for a search of the whole box: few samples and changes of inputs, with nearly the same optimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.levenberg_marquardt import (
    LocalResult,
    LocalSettings,
    QuadraticModel,
    cost_shape,
    levenberg_marquardt,
)
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.log_posterior import LogPosterior
from aero_bayes.estimate.measured_data import rows_of_first_readings, thin
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.simulation.interface import DelayTarget, Experiment, InputSignal, Outcome, Simulator

#: Gain in log-probability at which another local optimum is preferred.
MIN_LOG_EVIDENCE_GAIN = 0.5
#: Where searches may start between two samples, as shares of the interval. A reading just after a jump catches the
#: current while it rises, so that the last percents of an interval can have a local optimum of their own.
START_SHARES = (0.15, 0.5, 0.85, 0.95, 0.98, 0.99, 0.996)
#: Sample intervals, the nearest to the present delay, that are searched.
MAX_INTERVALS = 60
#: Points of the grid in a first scan.
SCAN_POINTS = 41


def delay_columns(objective: Objective, free: Sequence[int]) -> list[int]:
    """Free columns that are delays."""
    return [j for j in free if isinstance(objective.parameters.items[j].target, DelayTarget)]


def scan_delays(objective: Objective, fit: Optimum, free: Sequence[int]) -> FloatArray:
    """Set each recording's delay to the best point of a grid; returns the coordinates (p,).

    A jump at the wrong time makes a few outliers. So differences of successive residuals are scored, with a
    heavy-tailed (Cauchy) loss, and not the slow misfit of a first fit."""
    parameters = objective.parameters
    columns = delay_columns(objective, free)
    if not columns:
        return fit.coordinates
    rows = np.repeat(fit.coordinates[np.newaxis, :], SCAN_POINTS, axis=0)
    for j in columns:
        rows[:, j] = np.linspace(parameters.box[0][j], parameters.box[1][j], SCAN_POINTS)
    costs = np.full((SCAN_POINTS, len(objective.calibration.data.experiments)), np.inf)
    for k, found in enumerate(objective.residuals(rows)):
        if found is None:
            continue
        costs[k] = 0.0
        for s, series in enumerate(objective.series):
            width = 2.0 * fit.noise[series.output].sd_white
            costs[k, series.experiment] += float(np.sum(np.log1p((np.diff(found.residual[s]) / width) ** 2)))
    best = fit.coordinates.copy()
    for j in columns:
        own = parameters.items[j].recording
        best[j] = rows[int(np.argmin(costs[:, own] if own is not None else costs.sum(axis=1))), j]
    return best


#: For each delay, so many local searches start from the best points of a scan with the other parameters fixed.
MAX_STARTS = 6
LOCAL = LocalSettings(tolerance=1e-2, iterations=20)


def better_delays(objective: Objective, here: Optimum, free: Sequence[int], *, prior: bool) -> FloatArray | None:
    """Search the likeliest local optima of each delay in turn, with all parameters free; None if none is better."""
    if not delay_columns(objective, free):
        return None
    calibration, noise = objective.calibration, objective.noise_rows(here.noise)
    target = LogPosterior(
        calibration, objective.simulator, calibration.parameters.from_search(here.coordinates), free, prior=prior
    )
    cost_function, (low, high), point = target.cost_function(here.noise), target.box, here.coordinates[list(free)]
    shape, moved = cost_shape(target.parameters, range(len(free)), calibration.data.intervals), False
    for k, item in enumerate(target.parameters):
        starts = _starts(target, point, noise, k, item, calibration.data.intervals)
        found = [levenberg_marquardt(cost_function, start, low, high, LOCAL, shape=shape) for start in starts]
        scores = [laplace_log_evidence(f) for f in found]
        best = int(np.argmax(scores)) if scores else 0
        if best > 0 and scores[best] > scores[0] + MIN_LOG_EVIDENCE_GAIN:
            point, moved = found[best].point, True
    objective.outcomes.update(target.outcomes)
    if not moved:
        return None
    coordinates = here.coordinates.copy()
    coordinates[list(free)] = point
    return coordinates


def _starts(
    target: LogPosterior, point: FloatArray, noise: FloatArray, k: int, item: Parameter, intervals: Sequence[float]
) -> list[FloatArray]:
    """List the point itself, then the best points of a scan over one delay; empty if there is nothing to scan."""
    if not isinstance(item.target, DelayTarget):
        return []
    width = item.upper - item.lower
    interval = intervals[item.recording] if item.recording is not None else min(intervals)
    offsets = np.add.outer(interval * np.arange(width / interval), interval * np.array(START_SHARES)).ravel()
    offsets = offsets[
        (offsets < width) & (np.abs(item.lower + offsets - point[k] * width) <= 0.5 * MAX_INTERVALS * interval)
    ]
    if offsets.size < 2:
        return []
    trial = np.tile(point, (offsets.size, 1))
    trial[:, k] = (item.lower + offsets) / width
    order = np.argsort(target.cost(trial, noise))[:MAX_STARTS]
    return [point, *trial[order]]


def laplace_log_evidence(found: LocalResult[QuadraticModel]) -> float:
    """Compute the log-evidence of an optimum up to a constant, by Laplace's approximation.

    Minus infinity if it failed."""
    if found.quadratic is None:
        return -np.inf
    sign, determinant = np.linalg.slogdet(found.quadratic.hessian)
    return float(-found.cost - 0.5 * determinant) if sign > 0 else -np.inf


#: Nats by which the log-likelihood may differ for two values to count as equally good: it is noise of the solver.
EQUAL_LIKELIHOOD = 1e-2
#: Information, relative to that of the prior, below which a parameter has no effect on any output.
MIN_INFORMATION = 1e-8
#: Halvings of the range in which the end of a plateau is looked for: to less than a thousandth of the box.
BISECTIONS = 11
#: Number of values of a parameter without a slope that are tried, evenly over its box: it may act in steps.
TRIED_VALUES = 12


@dataclass(frozen=True)
class StepParameter:
    """A parameter that acts in steps: the fit is the same from ``lower`` to ``upper`` (SI units) and has no slope."""

    name: str
    lower: float
    upper: float

    @property
    def note(self) -> str:
        """What a reader should know."""
        return (
            f"acts in steps, so that the fit has no slope there: any value from {self.lower:.4g} to {self.upper:.4g} "
            "fits as well"
        )


def settle_blind(
    objective: Objective, here: Optimum, blind: Sequence[int]
) -> tuple[FloatArray, tuple[StepParameter, ...]]:
    """Put columns without a slope back to their start where the fit stays as good; the others keep what was found."""
    if not blind:
        return here.coordinates.copy(), ()
    parameters = objective.parameters
    start = parameters.to_search(parameters.start)
    point = here.coordinates.copy()
    point[list(blind)] = start[list(blind)]
    if _equal(objective, here, point):
        return point, ()
    point, steps = here.coordinates.copy(), []
    for j in blind:
        trial = point.copy()
        trial[j] = start[j]
        if _equal(objective, here, trial):
            point = trial
        else:
            steps.append(j)
    return point, tuple(_plateau(objective, here, point, j) for j in steps)


def other_plateaus(objective: Objective, here: Optimum) -> list[FloatArray]:
    """List where to fit from to leave a plateau: search coordinates (p,), one for each other value of the cost.

    Empty where all free columns have an effect there, or have none anywhere."""
    if not here.evaluation.slopes:
        return []
    size = np.diag(here.whitened.information) * objective.parameters.prior_sd()[list(here.free)] ** 2
    blind = [j for j, own in zip(here.free, size, strict=True) if own < MIN_INFORMATION]
    return [point for j in blind for point in _plateaus(objective, here.coordinates, j)[1:]]


def _plateaus(objective: Objective, point: FloatArray, column: int) -> list[FloatArray]:
    """Return the point, then one with another value of a column for each other sum of squares that its values give."""
    low, high = (bound[column] for bound in objective.parameters.box)
    trials = np.repeat(point[np.newaxis], 1 + TRIED_VALUES, axis=0)
    trials[1:, column] = low + (np.arange(TRIED_VALUES) + 0.5) / TRIED_VALUES * (high - low)
    distinct: dict[str, FloatArray] = {}
    for trial, found in zip(trials, objective.residuals(trials), strict=True):
        if found is not None:
            distinct.setdefault(f"{sum(float(r @ r) for r in found.residual):.5g}", trial)  # the solver's error aside
    return list(distinct.values())


def _equal(objective: Objective, here: Optimum, point: FloatArray) -> bool:
    return objective.levels(point[None], here.noise)[0] >= here.whitened.log_likelihood - EQUAL_LIKELIHOOD


def _plateau(objective: Objective, here: Optimum, point: FloatArray, column: int) -> StepParameter:
    """Return the range about the value found in which the likelihood stays the same."""
    ends = []
    for bound in (side[column] for side in objective.parameters.box):
        inside, outside = point[column], float(bound)
        if _equal(objective, here, _moved(point, column, outside)):
            inside = outside
        for _ in range(BISECTIONS if inside != outside else 0):
            middle = 0.5 * (inside + outside)
            if _equal(objective, here, _moved(point, column, middle)):
                inside = middle
            else:
                outside = middle
        ends.append(float(objective.parameters.from_search(_moved(point, column, inside))[column]))
    return StepParameter(objective.parameters.names[column], ends[0], ends[1])


def _moved(point: FloatArray, column: int, coordinate: float) -> FloatArray:
    moved = point.copy()
    moved[column] = coordinate
    return moved


#: Largest error of an output due to averaged inputs, at the starting values, as a share of its range.
MAX_AVERAGING_ERROR = 0.05
#: Where averages are too coarse, changes of the input per sample asked for in the part that is used in full.
CHANGES_PER_SAMPLE = 2
#: Limits of the solver for a search of the whole box: steps per sample, least number of steps, relative tolerance.
STEPS_PER_SAMPLE, MIN_STEPS, LOOSE_TOLERANCE = 10, 5000, 1e-4


def with_few_samples(calibration: Calibration, simulator: Simulator, samples: int) -> Calibration:
    """Return the calibration with about ``samples`` samples of each recording, and inputs that change about as rarely.

    An input that changes at every sample makes the solver restart there, however few outputs are asked for. So it is
    averaged over blocks where the outputs stay close, else only the beginning of the recording is used."""
    data = calibration.data
    thinned = replace(calibration, data=data.thinned(samples))
    if max(s.time.size for e in data.experiments for s in e.inputs or (_CONSTANT_INPUT,)) <= 2 * samples:
        return thinned
    blocks = (replace(e, inputs=tuple(_blocks(s, samples) for s in e.inputs)) for e in thinned.data.experiments)
    averaged = replace(calibration, data=data.with_experiments(blocks))
    if _close(calibration, simulator, averaged):
        return averaged
    changes = CHANGES_PER_SAMPLE * samples
    shorter = data.with_experiments(thin(_beginning(e, changes), changes) for e in data.experiments)
    return replace(calibration, data=shorter)


def with_loose_solver(calibration: Calibration) -> Calibration:
    """Allow few solver steps and a loose tolerance, since models in the whole box may be very stiff."""
    samples = max(e.time.size for e in calibration.data.experiments)
    steps = max(STEPS_PER_SAMPLE * samples, MIN_STEPS)
    return replace(calibration, solver=replace(calibration.solver, max_steps=steps, relative_tolerance=LOOSE_TOLERANCE))


_CONSTANT_INPUT = InputSignal("", np.zeros(1), np.zeros(1))


def _blocks(signal: InputSignal, samples: int) -> InputSignal:
    """Return an input averaged over blocks of equal length."""
    if signal.time.size <= 2 * samples:
        return signal
    held = signal.interpolation == "hold"
    start, stop = signal.time[1 if held else 0], signal.time[-1]
    edges = np.linspace(start, stop, samples + 1)
    heights = signal.values[:-1] if held else 0.5 * (signal.values[:-1] + signal.values[1:])
    area = np.concatenate(([0.0], np.cumsum(heights * np.diff(signal.time))))
    means = np.diff(np.interp(edges, signal.time, area)) / np.diff(edges)
    if not held:
        return replace(signal, time=0.5 * (edges[1:] + edges[:-1]), values=means)
    return replace(
        signal,
        time=np.concatenate(([signal.time[0]], edges)),
        values=np.concatenate(([signal.values[0]], means, [signal.values[-1]])),
    )


def _close(calibration: Calibration, simulator: Simulator, averaged: Calibration) -> bool:
    from aero_bayes.simulation.engines import open_simulator

    start = calibration.parameters.start[np.newaxis]
    whole = simulator.simulate(start)
    with open_simulator(averaged.problem(), workers=1) as other:
        few = other.simulate(start)
    if np.any(whole.outcomes != Outcome.OK) or np.any(few.outcomes != Outcome.OK):
        return False
    experiments = zip(calibration.data.experiments, averaged.data.experiments, strict=True)
    for full, part, (e, c) in zip(whole.outputs, few.outputs, experiments, strict=True):
        rows = np.searchsorted(e.time, c.time)
        error = np.sqrt(np.mean((full[0, rows] - part[0]) ** 2, axis=0))
        if np.any(error > MAX_AVERAGING_ERROR * np.maximum(np.ptp(full[0], axis=0), 1e-300)):
            return False
    return True


def _beginning(experiment: Experiment, changes: int) -> Experiment:
    """Return the beginning of an experiment, until its inputs have changed ``changes`` times."""
    ends = [s.time[changes] for s in experiment.inputs if s.time.size > changes]
    if not ends:
        return experiment
    rows = max(int(np.searchsorted(experiment.time, min(ends))), 2)
    if experiment.measured is not None:
        rows = max(rows, rows_of_first_readings(experiment.measured))
    last = float(experiment.time[rows - 1])
    inputs = []
    for s in experiment.inputs:
        count = max(int(np.searchsorted(s.time, last, side="right")), 1)
        inputs.append(replace(s, time=s.time[:count], values=s.values[:count]))
    return replace(experiment.at_samples(slice(rows)), inputs=tuple(inputs))
