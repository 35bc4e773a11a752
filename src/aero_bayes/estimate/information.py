"""Fisher information of an experiment that is not made yet, and the search for the best input signal.

The search is a Latin hypercube, then random local search from the best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.noise import SampleTimes
from aero_bayes.estimate.noise_estimation import whiten
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.swarm import latin_hypercube
from aero_bayes.progress import Progress, Watched
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    ParameterTarget,
    Problem,
    Simulator,
    Trajectories,
)
from aero_bayes.simulation.workers import WorkerPool

if TYPE_CHECKING:
    from aero_bayes.estimate.result import Fit

#: Largest number of samples in the sum of the information. More are thinned, and their white noise is scaled.
MAX_SAMPLES = 1500


@dataclass(frozen=True)
class Limits:
    """Limits of an experiment.

    Parameters
    ----------
    amplifier : float
        Largest input, in the input's unit.
    travel : mapping of str to float
        Largest absolute value by output, such as an angle between its stops in rad.
    """

    amplifier: float
    travel: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in {"amplifier": self.amplifier, **self.travel}.items():
            if not 0.0 < value < np.inf:
                raise InputError(f"limit of {name}: {value:g} is not a positive number")


@dataclass(frozen=True, eq=False)
class PredictedExperiment:
    """Prediction of a candidate experiment.

    ``information`` (p, p) is the Fisher information on the search coordinates of the shared parameters, with the delay
    of the new recording integrated out. ``travel`` is the largest absolute value by limited output."""

    information: FloatArray
    travel: Mapping[str, float]


class ExperimentPredictor:
    """Predicts experiments with a fitted model.

    ``shared`` are the parameters that a new recording has in common with those that were fitted, at ``values`` (p,)."""

    def __init__(
        self,
        fit: Fit,
        time: FloatArray,
        limits: Limits,
        workers: int | None = None,
        pool: WorkerPool | None = None,
    ) -> None:
        self.fit, self.full_time, self.limits = fit, time, limits
        self._run_by = workers, pool
        calibration, measured = fit.calibration, fit.calibration.data.outputs
        inputs = {signal.name for e in calibration.data.experiments for signal in e.inputs}
        if len(inputs) != 1:
            raise InputError(f"an experiment can be designed for a model with one driven input, not {len(inputs)}")
        self.input = inputs.pop()
        known = {v.name for v in calibration.model.outputs}
        for name in limits.travel:
            if name not in known:
                raise InputError(f"limit of {name}: model {calibration.model.name} has no such output")
        self.outputs = measured + tuple(n for n in limits.travel if n not in measured)
        items = calibration.parameters.items
        delays = [j for j, p in enumerate(items) if p.target == DelayTarget()]
        self._columns = [
            j for j, p in enumerate(items) if isinstance(p.target, ParameterTarget | DelayTarget) and j not in delays
        ]
        self.shared = ParameterSet(tuple(items[j] for j in self._columns))
        self.values = fit.values[self._columns]
        self.delay: Parameter | None = items[delays[0]] if delays else None
        self.delay_value = float(np.mean(fit.values[delays])) if delays else 0.0
        every = -(-time.size // MAX_SAMPLES)
        self.time = time[::every]
        # Of every n-th sample, with the information of all: the white part of the noise averages out.
        noise = (fit.noise[name] for name in measured)
        self._noise = [replace(n, sd_white=n.sd_white / every**0.5) for n in noise]
        self._sampling = SampleTimes.of(self.time, self.time)

    def precision(self) -> FloatArray:
        """Compute the posterior precision of the shared parameters in search coordinates, shape (p, p)."""
        total = np.diag(self.shared.prior_sd() ** -2.0)
        known = [k for k, j in enumerate(self._columns) if j in self.fit.free]
        rows = [self.fit.free.index(self._columns[k]) for k in known]
        total[np.ix_(known, known)] = np.linalg.inv(self.fit.covariance[np.ix_(rows, rows)])
        return total

    def draws(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw from the posterior of the shared parameters in SI units, shape (count, p)."""
        factor = np.linalg.cholesky(np.linalg.inv(self.precision()))
        low, high = self.shared.box
        point = self.shared.to_search(self.values) + rng.standard_normal((count, len(self.shared))) @ factor.T
        return self.shared.from_search(np.clip(point, low, high))

    def open(self, signals: Sequence[FloatArray], time: FloatArray | None = None) -> Simulator:
        """Return a simulator of the runs, from rest, that input signals (n,) on the full times make.

        Its columns are the shared parameters, then the delay."""
        calibration, start = self.fit.calibration, self.full_time[0]
        experiments = []
        for values in signals:
            at = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
            changes = np.concatenate([[start - 1.0], self.full_time[at]])
            signal = InputSignal(self.input, changes, np.concatenate([[0.0], values[at]]))
            experiments.append(Experiment(self.time if time is None else time, self.outputs, (signal,)))
        targets = (*(p.target for p in self.shared), DelayTarget())
        problem = Problem(
            calibration.model, tuple(experiments), (targets,) * len(experiments), dict(calibration.fixed),
            calibration.solver,
        )  # fmt: skip
        return open_simulator(problem, *self._run_by)

    def runs(self, signal: FloatArray, draws: FloatArray, time: FloatArray | None = None) -> Trajectories:
        """Simulate an input signal (n,) with values (k, p) of the shared parameters."""
        with self.open([signal], time) as simulator:
            return simulator.simulate(np.column_stack([draws, np.full(len(draws), self.delay_value)]))

    def predict(self, signals: Sequence[FloatArray]) -> list[PredictedExperiment | None]:
        """Predict experiments, one an input signal (n,) on the full times; None where the simulation failed."""
        with self.open(signals) as simulator:
            row = np.append(self.values, self.delay_value)[None]
            result = simulator.simulate(row, active=range(row.size))
        if result.sensitivities is None:
            return [None] * len(signals)
        slope = np.append(self.shared.jacobian(self.values), 1.0)
        return [
            None if code else self._predicted(y[0], s[0] * slope)
            for y, s, code in zip(result.outputs, result.sensitivities, result.outcomes[0], strict=True)
        ]

    def _predicted(self, outputs: FloatArray, sensitivities: FloatArray) -> PredictedExperiment:
        joint = self._gram(sensitivities)
        information = joint[:-1, :-1]
        if self.delay is not None:
            sd = float(ParameterSet((self.delay,)).prior_sd()[0]) * (self.delay.upper - self.delay.lower)
            own = joint[-1, -1] + 1.0 / sd**2  # the prior's
            information = information - np.outer(joint[:-1, -1], joint[-1, :-1]) / own
        travel = {n: float(np.max(np.abs(outputs[:, self.outputs.index(n)]))) for n in self.limits.travel}
        return PredictedExperiment(information, travel)

    def _gram(self, columns: FloatArray) -> FloatArray:
        """Multiply columns (n, m, a) by each other, weighed by the noise of the measured outputs: (a, a)."""
        whitened = (whiten(columns[:, k].T, self._sampling, noise)[0] for k, noise in enumerate(self._noise))
        return np.asarray(sum(rows @ rows.T for rows in whitened))


def posterior_sd(precision: FloatArray) -> FloatArray:
    """Compute standard deviations (p,) of a Gaussian with a precision matrix (p, p)."""
    scale = np.sqrt(np.diag(precision))
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(precision / np.outer(scale, scale)))) / scale)


#: Levels that an input holds one after the other.
LEVELS = 8
#: Scores of input signals on the full times, smaller is better, infinite for what is not allowed.
Score = Callable[[Sequence[FloatArray]], FloatArray]


def staircase(u: FloatArray, time: FloatArray) -> FloatArray:
    """Hold each of eight levels within plus and minus one for a share of the time, by a point of the unit cube."""
    levels, shares = 2.0 * u[:LEVELS] - 1.0, 0.15 + u[LEVELS:]
    ends = np.cumsum(shares) / shares.sum() * (time[-1] - time[0])
    index = np.searchsorted(ends, time - time[0], side="right")
    return np.asarray(levels[np.minimum(index, LEVELS - 1)])


@dataclass(frozen=True)
class SearchSettings:
    """Effort: candidates at the start, rounds of refinement, candidates a round."""

    start: int = 16
    rounds: int = 6
    candidates: int = 12
    spread: float = 0.25
    seed: int = 1


def best_signal(
    score: Score,
    time: FloatArray,
    rng: np.random.Generator,
    settings: SearchSettings,
    progress: Progress | None = None,
) -> tuple[FloatArray, float]:
    """Return the best staircase (n,) that was tried, and its score.

    The spread of a step shrinks by half every other round. The search ends with what it has where ``progress`` returns
    True."""
    tell = Watched(progress)
    point, best = np.zeros(2 * LEVELS), np.inf
    for turn in range(1 + settings.rounds):
        if turn == 0:
            cube = latin_hypercube(settings.start, point.size, rng)
        else:
            spread = settings.spread * 0.5 ** ((turn - 1) // 2)
            moved = point + spread * rng.standard_normal((settings.candidates, point.size))
            cube = 1.0 - np.abs(1.0 - np.abs(moved) % 2.0)
        scores = score([staircase(u, time) for u in cube])
        first = int(np.argmin(scores))
        if turn == 0 or scores[first] < best:
            point, best = cube[first], float(scores[first])
        if tell("candidates", (turn + 1) / (1 + settings.rounds), best):
            break
    return staircase(point, time), best
