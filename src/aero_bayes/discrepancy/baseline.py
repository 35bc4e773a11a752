"""The model as it stands, fitted to the recordings: what a missing effect must beat."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording, to_experiment
from aero_bayes.discrepancy.prepare import Ripple, quantum, remove_ripple, thin_standstill
from aero_bayes.discrepancy.refit import Refit, RefitSettings, refit
from aero_bayes.discrepancy.study import Study
from aero_bayes.errors import InputError
from aero_bayes.inference.parameters import Parameter
from aero_bayes.inference.priors import Normal, Uniform
from aero_bayes.simulation.interface import DelayTarget, Experiment, StartTarget
from aero_bayes.simulation.model import Model

FloatArray = NDArray[np.float64]

#: Longest input delay in s that is looked for.
LONGEST_DELAY = 0.02
#: Spread in rad of the pitch from which the body may have started, about its first reading.
START_SPREAD = 0.1


@dataclass(frozen=True, eq=False)
class Prepared:
    """Recordings as experiments, with what is known of their sensors.

    ``experiments`` hold the readings that count; ``quanta`` the steps of counting sensors by output.
    """

    names: tuple[str, ...]
    recordings: tuple[Recording, ...]
    experiments: tuple[Experiment, ...]
    quanta: Mapping[str, float]
    ripples: tuple[tuple[str, str, Ripple], ...] = ()

    @property
    def floors(self) -> dict[str, float]:
        """Least white noise by output: a count's standard deviation."""
        return {output: 0.9 * step / np.sqrt(12.0) for output, step in self.quanta.items()}


def prepare(recordings: Sequence[Recording], outputs: Sequence[str], most: int = 8000) -> Prepared:
    """Experiments of the recordings, readings of a sensor that stands still thinned.

    ``most`` is how many readings of an output a recording may keep; beyond it every n-th is kept.
    """
    experiments: list[Experiment] = []
    quanta: dict[str, float] = {}
    for recording in recordings:
        seen = tuple(output for output in outputs if output in recording.outputs)
        if not seen:
            raise InputError(f"{recording.name}: none of the outputs {', '.join(outputs)} was recorded")
        every = max(1, -(-recording.rows // most))
        thinned = recording.thin(every) if every > 1 else recording
        measured = thinned.measured(seen).copy()
        for column, output in enumerate(seen):
            step = quantum(recording.outputs[output])
            if step > 0.0:
                quanta[output] = max(step, quanta.get(output, 0.0))
                use = thin_standstill(recording.time, measured[:, column])
                measured[~use, column] = np.nan
        kept = np.flatnonzero(np.isfinite(measured).any(axis=1) | (np.arange(recording.rows) == 0))
        experiment = to_experiment(recording, seen)
        experiments.append(
            replace(experiment, time=np.ascontiguousarray(recording.time[kept]), measured=measured[kept])
        )
    return Prepared(tuple(recording.name for recording in recordings), tuple(recordings), tuple(experiments), quanta)


def nuisance_parameters(prepared: Prepared, model: Model) -> tuple[Parameter, ...]:
    """Input delay and starting pitch of each recording."""
    states = {state.name for state in model.states}
    several = len(prepared.names) > 1
    found = []
    for e, (name, experiment) in enumerate(zip(prepared.names, prepared.experiments, strict=True)):
        label = f"[{name}]" if several else ""
        if any(np.any(np.diff(signal.values)) for signal in experiment.inputs):
            found.append(
                Parameter(
                    f"input_delay{label}", "s", 0.4 * LONGEST_DELAY, 0.0, LONGEST_DELAY, Uniform(0.0, LONGEST_DELAY),
                    "linear", "Time from a commanded voltage to the applied one", DelayTarget(), e,
                )
            )  # fmt: skip
        pitch = next((state for state in ("theta", "body.theta") if state in states), None)
        if pitch is not None and "theta" in experiment.outputs:
            assert experiment.measured is not None
            readings = experiment.measured[:, experiment.outputs.index("theta")]
            first = float(readings[np.flatnonzero(np.isfinite(readings))[0]])
            found.append(
                Parameter(
                    f"theta_start{label}", "rad", first, first - 0.5, first + 0.5, Normal(first, START_SPREAD),
                    "linear", "Pitch from which the body starts at rest", StartTarget(pitch), e,
                )
            )  # fmt: skip
    return tuple(found)


def scan_delays(study: Study, fit: Refit, points: int = 41) -> FloatArray:
    """Coordinates with each recording's delay at the best of a grid.

    A delay moves a jump across the samples; the likelihood has a narrow valley between every two of them, which a
    local search does not leave.
    """
    parameters = study.parameters
    columns = [j for j, p in enumerate(parameters) if isinstance(p.target, DelayTarget) and j in fit.free]
    if not columns:
        return fit.coordinates
    grid = np.linspace(0.0, LONGEST_DELAY, points)
    rows = np.repeat(fit.coordinates[np.newaxis, :], points, axis=0)
    for j in columns:
        values = np.full(points, parameters.items[j].upper)
        values = np.minimum(grid, values)
        rows[:, j] = values / (parameters.items[j].upper - parameters.items[j].lower)
    costs = np.full((points, len(study.experiments)), np.inf)
    for k, residual in enumerate(study.residuals(rows)):
        if residual is None:
            continue
        per = np.zeros(len(study.experiments))
        for s, series in enumerate(study.series):
            noise = fit.noise[series.output]
            # A jump that is missed is a few wild readings: weigh those, not the slow misfit.
            fast = np.diff(residual[s])
            per[series.experiment] += float(np.sum(np.log1p((fast / (2.0 * noise.white)) ** 2)))
        costs[k] = per
    best = fit.coordinates.copy()
    for j in columns:
        own = parameters.items[j].recording
        best[j] = rows[int(np.argmin(costs[:, own] if own is not None else costs.sum(axis=1))), j]
    return best


def fit_base(study: Study, free: Sequence[int], settings: RefitSettings) -> Refit:
    """Fit the model as it stands, from its parameters' starts.

    Raises
    ------
    CannotFinishError
        If the model cannot be simulated there.
    """
    start = study.parameters.to_search(study.parameters.start)
    delays = {j for j in free if isinstance(study.parameters.items[j].target, DelayTarget)}
    steady = tuple(j for j in free if j not in delays)
    first = refit(study, start, steady, settings=replace(settings, iterations=12, tolerance=1.0))
    wide = refit(study, first.coordinates, free, noise=first.noise, settings=replace(settings, iterations=1))
    return refit(study, scan_delays(study, wide), free, noise=first.noise, settings=settings)


def without_ripple(prepared: Prepared, study: Study, fit: Refit) -> Prepared:
    """The readings with rotor-locked ripple subtracted, where a speed was measured.

    Only recordings on an even grid; an output is left alone where no ripple is found.
    """
    experiments = list(prepared.experiments)
    found: list[tuple[str, str, Ripple]] = []
    speeds = {s.experiment: s for s in study.series if s.output == "omega_m"}
    for k, series in enumerate(study.series):
        if series.experiment not in speeds or series.sampling.starts.size > 1:
            continue
        if prepared.quanta.get(series.output, 0.0) > fit.noise[series.output].sd:
            continue
        fast = speeds[series.experiment]
        # The measured speed, not the fitted one: its noise averages out of the angle, a misfit would not.
        speed = np.interp(series.sampling.time, fast.sampling.time, fast.measured)
        subtract, drop, ripples = remove_ripple(series.sampling.time, fit.evaluation.residual[k], speed)
        if not ripples:
            continue
        experiment = experiments[series.experiment]
        assert experiment.measured is not None
        measured = experiment.measured.copy()
        index = series.sampling.index
        measured[index, series.column] = np.where(drop, np.nan, series.measured - subtract)
        experiments[series.experiment] = replace(experiment, measured=measured)
        found += [(prepared.names[series.experiment], series.output, ripple) for ripple in ripples]
    return replace(prepared, experiments=tuple(experiments), ripples=tuple(found))
