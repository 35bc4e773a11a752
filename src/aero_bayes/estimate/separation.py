"""The experiment that tells two models apart, and the outputs that are expected of a proposed experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.information import ExperimentPredictor, Limits, PredictedExperiment
from aero_bayes.estimate.propose import (
    TRAVEL_SHARE,
    Design,
    ProposedInput,
    default_limits,
    experiment_times,
    within_travel,
)
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.signal_search import SearchSettings, best_signals
from aero_bayes.progress import Progress
from aero_bayes.simulation.interface import Engine
from aero_bayes.simulation.workers import WorkerPool


@dataclass(frozen=True, eq=False)
class Separation(ProposedInput):
    """A proposed experiment, and the expected difference in log-evidence of two models.

    ``first_true`` and ``second_true`` are expected differences in log-evidence in favour of the true one; below about
    three, the experiment is not worth making. ``families`` has the best such difference of each kind of signal."""

    JSON_KEYS: ClassVar = "input family families duration log_evidence first_true second_true travel limits seed table"

    families: Mapping[str, float]
    first_true: float
    second_true: float
    travel: Mapping[str, float]
    limits: Limits
    seed: int

    @property
    def log_evidence(self) -> float:
        """Expected difference in log-evidence, whichever model is true."""
        return min(self.first_true, self.second_true)


def separating_experiment(
    first: Fit,
    second: Fit,
    *,
    duration: float = 30.0,
    rate_hz: float | None = None,
    limits: Limits | None = None,
    settings: SearchSettings | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Separation:
    """Return the input signal within given limits that separates two models of one rig best."""
    outputs = first.calibration.data.outputs, second.calibration.data.outputs
    if outputs[0] != outputs[1]:
        raise InputError(f"the two fits are of different outputs: {outputs[0]} and {outputs[1]}")
    limits, settings = limits or default_limits(first), settings or SearchSettings()
    time = experiment_times(first, duration, rate_hz)
    rng = np.random.default_rng(settings.seed)
    with WorkerPool(workers) as pool:
        a, b = (ExperimentPredictor(fit, time, limits, settings.engine, workers, pool) for fit in (first, second))
        known = (a.precision(), b.precision())

        def both(signals: Sequence[FloatArray]) -> list[tuple[float, float]]:
            volts = [limits.amplifier * s for s in signals]
            return [_differences(a, b, known, p, q) for p, q in zip(a.predict(volts), b.predict(volts), strict=True)]

        def score(signals: Sequence[FloatArray]) -> FloatArray:
            return -np.array([min(pair) for pair in both(signals)])

        found = best_signals(score, time, rng, settings, progress)
        if not np.isfinite(found[0].score):
            raise CannotFinishError("no candidate experiment stays within the travel; allow more of it")
        values, travel = within_travel(a, limits.amplifier * found[0].values, rng)
        values, other = within_travel(b, values, rng)
        first_true, second_true = both([values / limits.amplifier])[0]
        return Separation(
            a.input, time, values, found[0].family.name, {f.family.name: -f.score for f in found},
            first_true, second_true, {n: max(travel[n], other[n]) for n in travel}, limits, settings.seed,
        )  # fmt: skip


def _differences(
    a: ExperimentPredictor,
    b: ExperimentPredictor,
    known: tuple[FloatArray, FloatArray],
    p: PredictedExperiment | None,
    q: PredictedExperiment | None,
) -> tuple[float, float]:
    """Compute the expected log-evidence for each model if it is true; minus infinity out of travel."""
    if p is None or q is None:
        return -np.inf, -np.inf
    if any(max(p.travel[n], q.travel[n]) > TRAVEL_SHARE * limit for n, limit in a.limits.travel.items()):
        return -np.inf, -np.inf
    return _unexplained(b, known[1], p.outputs - q.outputs, q), _unexplained(a, known[0], q.outputs - p.outputs, p)


def _unexplained(
    rival: ExperimentPredictor, known: FloatArray, difference: FloatArray, own: PredictedExperiment
) -> float:
    """Compute half the squared norm of a whitened difference (n, m), less the part that the other model can explain."""
    columns = own.sensitivities if rival.delay is not None else own.sensitivities[:, :, :-1]
    p = known.shape[0]
    leeway = np.zeros((columns.shape[2],) * 2)
    leeway[:p, :p] = known
    if rival.delay is not None:
        leeway[-1, -1] = rival.delay_precision
    square = float(rival.gram(difference[:, :, None], difference[:, :, None])[0, 0])
    follow = rival.gram(columns, difference[:, :, None])[:, 0]
    moved = np.linalg.solve(rival.gram(columns, columns) + leeway, follow)
    return 0.5 * max(square - float(follow @ moved), 0.0)


def expected_outputs(
    proposal: Design | Separation,
    fit: Fit,
    *,
    draws: int = 40,
    seed: int = 1,
    engine: Engine = "native",
    workers: int | None = None,
) -> dict[str, FloatArray]:
    """Return 5 %, 50 % and 95 % quantiles (3, n) of each output at the times of a proposal, without sensor noise.

    They are over the posterior of the parameters of a fitted model."""
    predictor = ExperimentPredictor(fit, proposal.time, proposal.limits, engine, workers)
    values = predictor.draws(draws, np.random.default_rng(seed))
    rows = np.column_stack([values, np.full(draws, predictor.delay_value)])
    experiment = predictor.experiment(proposal.values, proposal.time)
    with predictor.open(predictor.problem([experiment])) as simulator:
        result = simulator.simulate(rows)
    usable = result.outputs[0][result.outcomes[:, 0] == 0]
    if not len(usable):
        raise CannotFinishError("the proposed experiment could not be simulated")
    quantiles = np.quantile(usable, (0.05, 0.5, 0.95), axis=0)
    return {output: quantiles[:, :, k] for k, output in enumerate(predictor.outputs)}
