"""Fisher information of an experiment that is not made yet, from simulated sensitivities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.noise import OutputNoise, SampleTimes
from aero_bayes.estimate.noise_estimation import whiten
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    DelayTarget,
    Engine,
    Experiment,
    InputSignal,
    ParameterTarget,
    Problem,
    Simulator,
)
from aero_bayes.simulation.workers import WorkerPool

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
    outputs: FloatArray
    sensitivities: FloatArray


class ExperimentPredictor:
    """Predicts experiments with a fitted model."""

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
        self._engine: Engine = engine
        self._workers, self._pool = workers, pool
        calibration = fit.calibration
        inputs = {signal.name for e in calibration.data.experiments for signal in e.inputs}
        if len(inputs) != 1:
            raise InputError(f"an experiment can be designed for a model with one driven input, not {len(inputs)}")
        self.input = inputs.pop()
        known = {v.name for v in calibration.model.outputs}
        for name in limits.travel:
            if name not in known:
                raise InputError(f"limit of {name}: model {calibration.model.name} has no such output")
        self.limited = tuple(limits.travel)
        self.outputs = calibration.data.outputs + tuple(n for n in self.limited if n not in calibration.data.outputs)
        columns = [
            j
            for j, p in enumerate(calibration.parameters)
            if isinstance(p.target, ParameterTarget | DelayTarget) and p.target != DelayTarget()
        ]
        self.shared = ParameterSet(tuple(calibration.parameters.items[j] for j in columns))
        self.values = fit.values[columns]
        self._columns = columns
        delays = [j for j, p in enumerate(calibration.parameters) if p.target == DelayTarget()]
        self.delay: Parameter | None = calibration.parameters.items[delays[0]] if delays else None
        self.delay_value = float(np.mean(fit.values[delays])) if delays else 0.0
        every = -(-time.size // MAX_SAMPLES)
        self.time = time[::every]
        self._noise = [_thinned(fit.noise[name], every) for name in calibration.data.outputs]
        self._sampling = SampleTimes.of(self.time, self.time)

    def precision(self) -> FloatArray:
        """Compute the posterior precision of the shared parameters in search coordinates, shape (p, p)."""
        total = np.diag(self.shared.prior_sd() ** -2.0)
        known = [k for k, j in enumerate(self._columns) if j in self.fit.free]
        rows = [self.fit.free.index(self._columns[k]) for k in known]
        block = self.fit.covariance[np.ix_(rows, rows)]
        total[np.ix_(known, known)] = np.linalg.inv(block)
        return total

    def draws(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw from the posterior of the shared parameters in SI units, shape (count, p)."""
        factor = np.linalg.cholesky(np.linalg.inv(self.precision()))
        low, high = self.shared.box
        point = self.shared.to_search(self.values) + rng.standard_normal((count, len(self.shared))) @ factor.T
        return self.shared.from_search(np.clip(point, low, high))

    def experiment(self, values: FloatArray, time: FloatArray | None = None) -> Experiment:
        """Return the run that an input signal (n,) on the full times makes, from rest."""
        changes = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
        start = self.full_time[0]
        signal = InputSignal(
            self.input,
            np.concatenate([[start - 1.0], self.full_time[changes]]),
            np.concatenate([[0.0], values[changes]]),
        )
        return Experiment(self.time if time is None else time, self.outputs, (signal,))

    def problem(self, experiments: Sequence[Experiment]) -> Problem:
        """Return the problem of some experiments; its columns are the shared parameters, then the delay."""
        calibration = self.fit.calibration
        targets = (*(p.target for p in self.shared), DelayTarget())
        return Problem(
            calibration.model, tuple(experiments), (targets,) * len(experiments), dict(calibration.simulated.fixed),
            calibration.simulated.solver,
        )  # fmt: skip

    def open(self, problem: Problem) -> Simulator:
        """Return a simulator on this forecaster's workers."""
        return open_simulator(problem, self._engine, self._workers, self._pool)

    def predict(
        self, signals: Sequence[FloatArray], values: FloatArray | None = None
    ) -> list[PredictedExperiment | None]:
        """Predict experiments, one an input signal (n,) on the full times; None where the simulation failed.

        ``values`` are the shared parameters' SI values, the fitted ones by default."""
        at = self.values if values is None else values
        with self.open(self.problem([self.experiment(s) for s in signals])) as simulator:
            row = np.append(at, self.delay_value)[None]
            result = simulator.simulate(row, active=range(len(at) + 1))
        if result.sensitivities is None:
            return [None] * len(signals)
        slope = np.append(self.shared.jacobian(at), 1.0)
        return [
            None if code else self._predicted(y[0], s[0] * slope)
            for y, s, code in zip(result.outputs, result.sensitivities, result.outcomes[0], strict=True)
        ]

    def _predicted(self, outputs: FloatArray, sensitivities: FloatArray) -> PredictedExperiment:
        joint = self.gram(sensitivities, sensitivities)
        travel = {n: float(np.max(np.abs(outputs[:, self.outputs.index(n)]))) for n in self.limited}
        return PredictedExperiment(self.without_delay(joint), travel, outputs, sensitivities)

    def gram(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Multiply columns, weighed by the noise of the measured outputs: (n, m, a) with (n, m, b) to (a, b)."""
        total = np.zeros((left.shape[2], right.shape[2]))
        for k, noise in enumerate(self._noise):
            rows, _ = whiten(np.concatenate((left[:, k], right[:, k]), axis=1).T, self._sampling, noise)
            total += rows[: len(total)] @ rows[len(total) :].T
        return total

    def without_delay(self, joint: FloatArray) -> FloatArray:
        """Integrate the new recording's delay, the last column, out of the information."""
        if self.delay is None:
            return joint[:-1, :-1]
        own = joint[-1, -1] + self.delay_precision
        return np.asarray(joint[:-1, :-1] - np.outer(joint[:-1, -1], joint[-1, :-1]) / own)

    @property
    def delay_precision(self) -> float:
        """Prior precision of the delay of a new recording, in 1/s^2; infinite if the fit has no delay."""
        if self.delay is None:
            return np.inf
        sd = float(ParameterSet((self.delay,)).prior_sd()[0]) * (self.delay.upper - self.delay.lower)
        return 1.0 / sd**2


def _thinned(noise: OutputNoise, every: int) -> OutputNoise:
    """Return noise for which every n-th sample has the information of all samples: the white part averages out."""
    return replace(noise, sd_white=noise.sd_white / every**0.5)


def posterior_sd(precision: FloatArray) -> FloatArray:
    """Compute standard deviations (p,) of a Gaussian with a precision matrix (p, p)."""
    scale = np.sqrt(np.diag(precision))
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(precision / np.outer(scale, scale)))) / scale)
