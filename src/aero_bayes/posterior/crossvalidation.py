"""Cross-validation of a fit: later blocks of a recording, or whole recordings, are left out and predicted."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate import cost as costs
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings, levenberg_marquardt
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise_estimation import reading_log_density
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.target import JointTarget, NoiseLayout, Target
from aero_bayes.posterior.comparison import ElpdEstimate, leave_future_out, leave_one_out, waic
from aero_bayes.posterior.importance import importance_posterior
from aero_bayes.progress import Progress
from aero_bayes.simulation.interface import DelayTarget, Outcome

#: Largest number of simulated values in memory.
_MAX_TRAJECTORY_NUMBERS = 4_000_000


def block_edges(joint: JointTarget, blocks: int) -> tuple[FloatArray, ...]:
    """Return times that split each recording into blocks of equal length, each shape (blocks + 1,)."""
    return tuple(np.linspace(e.time[0], e.time[-1], blocks + 1) for e in joint.target.calibration.data.experiments)


def block_log_likelihood(joint: JointTarget, points: FloatArray, edges: Sequence[FloatArray]) -> list[FloatArray]:
    """Compute the log-density of every block of every recording given the readings before it."""
    experiments = joint.target.calibration.data.experiments
    size = sum(e.time.size * len(e.outputs) for e in experiments)
    batch = max(1, _MAX_TRAJECTORY_NUMBERS // size)
    parts = [_batch(joint, points[k : k + batch], edges) for k in range(0, len(points), batch)]
    return [np.concatenate([part[e] for part in parts]) for e in range(len(experiments))]


def _batch(joint: JointTarget, points: FloatArray, edges: Sequence[FloatArray]) -> list[FloatArray]:
    target, f = joint.target, len(joint.target.free)
    result = target.simulator.simulate(target.values(points[:, :f]))
    noise = joint.layout.unpack(points[:, f:])[:, 0]
    found = []
    for e, experiment in enumerate(target.calibration.data.experiments):
        measured, count = target.calibration.data.measured[e], edges[e].size - 1
        block = np.clip(np.searchsorted(edges[e], experiment.time, side="right") - 1, 0, count - 1)
        total = np.zeros((len(points), count))
        for k in range(measured.shape[1]):
            seen = np.isfinite(measured[:, k])
            if seen.any():
                residual = measured[seen, k] - result.outputs[e][:, seen, k]
                density = reading_log_density(experiment.time[seen], residual, noise[:, k])
                np.add.at(total.T, block[seen], density.T)
        failed = result.outcomes[:, e] != Outcome.OK
        total[failed | ~np.all(np.isfinite(total), axis=1)] = -np.inf
        found.append(total)
    return found


_REFIT_SETTINGS = FitSettings(method="local", staged=False)
#: Number of delays that are tried before the best one is refined.
_DELAY_POINTS = 21


@dataclass(frozen=True, eq=False)
class TimeOrderedScores:
    """WAIC, leave-one-out and leave-future-out of one fit over blocks of time, from the same draws."""

    waic: ElpdEstimate
    leave_one_out: ElpdEstimate
    leave_future_out: ElpdEstimate

    def to_dict(self) -> dict[str, object]:
        return {
            "waic": self.waic.to_dict(),
            "leave_one_out": self.leave_one_out.to_dict(),
            "leave_future_out": self.leave_future_out.to_dict(),
        }


@dataclass(frozen=True, eq=False)
class LeftOutPrediction:
    """A recording that was left out and predicted by a fit to the others.

    ``rms`` is the error of the prediction by output, ``rms_fitted`` that of the fit to all recordings. ``elpd`` is the
    log-density of the recording under the posterior of the others, with its own delay and initial state integrated out.
    Outputs that no other recording has are not predicted.
    """

    recording: str
    rms: Mapping[str, float]
    rms_fitted: Mapping[str, float]
    elpd: float

    def to_dict(self) -> dict[str, object]:
        return {"rms": dict(self.rms), "rms_fitted": dict(self.rms_fitted), "elpd": self.elpd}


def time_ordered_scores(
    fit: Fit,
    open_simulator: OpenSimulator,
    rng: np.random.Generator,
    *,
    blocks: int = 12,
    first: int = 4,
    draws: int = 400,
    refits: bool = True,
    progress: Progress | None = None,
) -> TimeOrderedScores:
    """Return WAIC, leave-one-out and leave-future-out of a fit over blocks of its recordings."""
    whole = fit.calibration
    # An output that the first fit has not seen has no noise, by which its readings could be judged.
    whole = replace(whole, data=_with_outputs_of(whole.data, _until(whole.data, first / blocks)))
    densities = _densities(fit, whole, open_simulator, rng, blocks, draws)

    def refit(known: int) -> FloatArray:
        if progress is not None:
            progress("refits", 1.0 - known / blocks, f"first {known} of {blocks} stretches")
        data, parameters = _until(whole.data, known / blocks), whole.parameters.with_start(fit.values)
        start = replace(whole, data=data, parameters=parameters)
        earlier = fit_calibration(start, open_simulator, _REFIT_SETTINGS, rng)
        return np.asarray(np.sum(_densities(earlier, whole, open_simulator, rng, blocks, draws), axis=0))

    pooled = np.concatenate(densities, axis=1)
    together = np.sum(densities, axis=0)
    return TimeOrderedScores(
        waic(pooled), leave_one_out(pooled), leave_future_out(together, first, refit if refits else None)
    )


def leave_one_recording_out(
    fit: Fit,
    open_simulator: OpenSimulator,
    rng: np.random.Generator,
    *,
    draws: int = 40,
    time_limit: float = math.inf,
    progress: Progress | None = None,
) -> tuple[LeftOutPrediction, ...]:
    """Predict each recording from a fit to the others.

    The other recordings do not predict the nuisance parameters of a recording (its delay, its initial state). For every
    draw, these are fitted within their priors and integrated out by Laplace's approximation."""
    began = time.perf_counter()
    calibration = fit.calibration
    if len(calibration.data.experiments) < 2:
        raise InputError("leaving a recording out needs at least two")
    found: list[LeftOutPrediction] = []
    for index, name in enumerate(calibration.data.names):
        if found and (time.perf_counter() - began) * (index + 1) / index > time_limit:
            break
        if progress is not None:
            progress("recordings", index / len(calibration.data.names), name)
        others = _select(calibration, [e for e in range(len(calibration.data.names)) if e != index], fit.values)
        alone = _select(calibration, [index], fit.values)
        alone = replace(alone, data=_with_outputs_of(alone.data, others.data))
        if not alone.data.count:
            continue  # nothing that it measured was measured elsewhere
        rest = fit_calibration(others, open_simulator, _REFIT_SETTINGS, rng)
        with open_simulator(others.problem()) as simulator:
            sample = importance_posterior(rest, simulator, 8 * draws, rng).resample(draws, rng)
        found.append(_predict(fit, rest, alone, index, sample, open_simulator))
    return tuple(found)


def _densities(
    fit: Fit,
    calibration: Calibration,
    open_simulator: OpenSimulator,
    rng: np.random.Generator,
    blocks: int,
    draws: int,
) -> list[FloatArray]:
    """Compute log-densities of every block of the recordings over draws of a fit's posterior, (s, b) each."""
    with open_simulator(fit.calibration.problem()) as simulator:
        sample = importance_posterior(fit, simulator, 8 * draws, rng).resample(draws, rng)
    with open_simulator(calibration.problem()) as simulator:
        joint = replace(fit, calibration=calibration).joint_target(simulator)
        return block_log_likelihood(joint, sample, block_edges(joint, blocks))


def _until(data: MeasuredData, share: float) -> MeasuredData:
    """Return the data with only the first share of each recording's time."""
    kept = []
    for e in data.experiments:
        end = int(np.searchsorted(e.time, e.time[0] + share * (e.time[-1] - e.time[0]), side="left"))
        kept.append(e.at_samples(slice(end)))
    return data.with_experiments(kept)


def _with_outputs_of(data: MeasuredData, known: MeasuredData) -> MeasuredData:
    """Return the data without readings of outputs that other data have none of."""
    blind = ~np.isfinite(np.concatenate(known.measured)).any(axis=0)
    return data.with_experiments(
        replace(e, measured=np.where(blind, np.nan, y)) for e, y in zip(data.experiments, data.measured, strict=True)
    )


def _select(calibration: Calibration, chosen: list[int], values: FloatArray) -> Calibration:
    """Return the problem of some of the recordings, with the parameters that act in them, started at ``values``."""
    items = []
    for item, value in zip(calibration.parameters, values, strict=True):
        if item.recording is None:
            items.append(replace(item, start=float(value)))
        elif item.recording in chosen:
            items.append(replace(item, start=float(value), recording=chosen.index(item.recording)))
    every = calibration.data
    data = replace(
        every,
        experiments=tuple(every.experiments[e] for e in chosen),
        names=tuple(every.names[e] for e in chosen),
        recordings=tuple(every.recordings[e] for e in chosen if every.recordings),
    )
    return replace(calibration, data=data, parameters=ParameterSet(tuple(items)))


def _predict(
    fit: Fit, rest: Fit, alone: Calibration, index: int, sample: FloatArray, open_simulator: OpenSimulator
) -> LeftOutPrediction:
    """Return one recording under draws of the others' posterior (s, d)."""
    own = [j for j, p in enumerate(alone.parameters) if p.recording is not None]
    layout = NoiseLayout.of(rest.calibration.data, rest.noise)
    split = rest.laplace.parameters
    densities: list[float] = []
    fitted = np.empty(0)
    with open_simulator(alone.problem()) as simulator:
        for point in np.vstack([rest.laplace.mean, sample]):
            target = Target(alone, simulator, _values(alone, rest, point[:split]), own)
            density, values = _integrated(target, layout.unpack(point[None, split:])[0])
            if not densities:
                fitted = simulator.simulate(values[None]).outputs[0][0]
            densities.append(density)
    error = costs.rms_overall([alone.data.measured[0] - fitted], fit.outputs)
    own_fit = costs.rms_overall([fit.residuals[index]], fit.outputs)
    elpd = float(logsumexp(densities[1:]) - math.log(len(densities) - 1))
    return LeftOutPrediction(alone.data.names[0], error, {o: own_fit[o] for o in error}, elpd)


def _values(alone: Calibration, rest: Fit, coordinates: FloatArray) -> FloatArray:
    """Compute SI values (p,) for a recording left out: shared ones from the others' posterior, own ones at a start."""
    items = rest.calibration.parameters.items
    searched = ParameterSet(tuple(items[j] for j in rest.free))
    drawn = dict(zip(searched.names, searched.from_search(coordinates).tolist(), strict=True))
    shared = {p.name: drawn.get(p.name, float(rest[p.name])) for p in alone.parameters if p.recording is None}
    return np.array([shared.get(p.name, p.start) for p in alone.parameters])


def _integrated(target: Target, noise: FloatArray) -> tuple[float, FloatArray]:
    """Compute the log-density of readings with the free nuisances integrated out, and the values at their mode."""
    if not target.free:
        return float(np.sum(target.log_likelihood(np.empty((1, 0)), noise[None]))), target.base
    start = target.parameters.to_search(target.base[list(target.free)])
    low, high = target.box
    delays = [k for k, p in enumerate(target.parameters) if isinstance(p.target, DelayTarget)]
    if delays:
        trial = np.tile(start, (_DELAY_POINTS, 1))
        for k in delays:
            trial[:, k] = np.linspace(low[k], high[k], _DELAY_POINTS)
        start = trial[int(np.argmin(target.cost(trial, noise[None])))]
    found = levenberg_marquardt(target.cost_function(noise[None]), start, low, high)
    if found.quadratic is None:
        return -math.inf, target.values(start[None])[0]
    determinant = float(np.linalg.slogdet(found.quadratic.hessian)[1])
    volume = 0.5 * (len(target.free) * math.log(2.0 * math.pi) - determinant)
    return volume - found.cost, target.values(found.point[None])[0]
