"""Fisher information of an experiment that is not made yet, and the search over families of input signals for the best.

The search is a Latin hypercube, then random local search from the best of each family."""

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
    Engine,
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
        engine: Engine = "native",
        workers: int | None = None,
        pool: WorkerPool | None = None,
    ) -> None:
        self.fit, self.full_time, self.limits = fit, time, limits
        self._run_by = engine, workers, pool
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


#: Steps a staircase takes, and sines a sum has.
STEPS, SINES = 8, 10
#: How often a signal that is not made of jumps is updated, in Hz.
UPDATE_HZ = 20.0


@dataclass(frozen=True)
class SignalFamily:
    """Signals of one kind: ``signal`` maps a point (``size``,) of the unit cube and times (n,) in s to values (n,)."""

    name: str
    size: int
    signal: Callable[[FloatArray, FloatArray], FloatArray]


def _staircase_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Hold each of eight levels for a share of the time."""
    levels, shares = 2.0 * u[:STEPS] - 1.0, 0.15 + u[STEPS:]
    ends = np.cumsum(shares) / shares.sum() * (time[-1] - time[0])
    index = np.searchsorted(ends, time - time[0], side="right")
    return np.asarray(levels[np.minimum(index, STEPS - 1)])


def _multi_sine_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Sum ten sines with random phases: height, offset, lowest and highest frequency, and which phases."""
    low = _between(u[2], 0.05, 0.5)
    frequency = np.geomspace(low, low * _between(u[3], 2.0, 30.0), SINES)
    phase = np.random.default_rng(int(1e6 * u[4])).uniform(0.0, 2.0 * np.pi, SINES)
    wave = np.sin(np.outer(_updates(time), 2.0 * np.pi * frequency) + phase).sum(axis=1)
    return np.clip(_swing(u, wave / max(float(np.abs(wave).max()), 1e-9)), -1.0, 1.0)


def _swing(u: FloatArray, wave: FloatArray) -> FloatArray:
    return np.asarray(u[0] * wave + (2.0 * u[1] - 1.0))


def _between(u: float, low: float, high: float) -> float:
    return float(low * (high / low) ** u)


def _updates(time: FloatArray) -> FloatArray:
    """Return the time since the start, rounded down to the last update."""
    return np.asarray(np.floor((time - time[0]) * UPDATE_HZ + 1e-9) / UPDATE_HZ)


FAMILIES = (
    SignalFamily("steps", 2 * STEPS, _staircase_signal),
    SignalFamily("multi-sine", 5, _multi_sine_signal),
)


#: Scores of input signals on the full times, smaller is better, infinite for what is not allowed.
Score = Callable[[Sequence[FloatArray]], FloatArray]


@dataclass(frozen=True, eq=False)
class BestSignal:
    """The best signal of a family: where in the unit cube, its values (n,) within plus and minus one, its score."""

    family: SignalFamily
    point: FloatArray
    values: FloatArray
    score: float


@dataclass(frozen=True)
class SearchSettings:
    """Effort: candidates a family at the start, rounds of refinement, candidates a round, how many families go on.

    ``engine`` is what simulates them."""

    start: int = 16
    rounds: int = 6
    candidates: int = 12
    families: int = 2
    spread: float = 0.25
    seed: int = 1
    engine: Engine = "native"


def best_signals(
    score: Score,
    time: FloatArray,
    rng: np.random.Generator,
    settings: SearchSettings,
    progress: Progress | None = None,
) -> list[BestSignal]:
    """Return the best signal of each family, best first; the best families are refined.

    A step's spread shrinks by half every other round; a family's best only ever improves. The search ends with what it
    has where ``progress`` returns True."""
    tell = Watched(progress)
    steps = len(FAMILIES) + settings.rounds * settings.families
    found = []
    for k, family in enumerate(FAMILIES):
        cube = latin_hypercube(settings.start, family.size, rng)
        found.append(_best(score, family, cube, time))
        if tell("candidates", (k + 1) / steps, family.name):
            break
    found.sort(key=lambda f: f.score)
    for k in range(min(settings.families, len(found))):
        for turn in range(settings.rounds if not tell.asked_to_end else 0):
            spread = settings.spread * 0.5 ** (turn // 2)
            here = found[k]
            moved = here.point + spread * rng.standard_normal((settings.candidates, here.family.size))
            again = _best(score, here.family, 1.0 - np.abs(1.0 - np.abs(moved) % 2.0), time)
            if again.score < here.score:
                found[k] = again
            if tell("candidates", (len(FAMILIES) + k * settings.rounds + turn + 1) / steps, here.family.name):
                break
    return sorted(found, key=lambda f: f.score)


def _best(score: Score, family: SignalFamily, cube: FloatArray, time: FloatArray) -> BestSignal:
    signals = [family.signal(u, time) for u in cube]
    scores = score(signals)
    best = int(np.argmin(scores))
    return BestSignal(family, cube[best], signals[best], float(scores[best]))
