"""Compare recordings with a model: residuals with their sensitivities, or likelihoods reduced inside the engine.

Both routes use the same calibration and noise, and agree (tested). A local fit that estimates the noise between its
steps needs the residuals. A sampler asks for thousands of likelihoods, which the engine reduces itself.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.checkpoint import Arrays, ResultCache, digest
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.sensors.noise import OutputNoise, SampleTimes
from aero_bayes.sensors.whitening import LOG_2PI, whiten
from aero_bayes.simulation.interface import GaussNewton, Outcome, Simulator, Trajectories

FloatArray = NDArray[np.float64]
#: Noise of an output that does not count, over its range.
IGNORED_NOISE_FACTOR = 1e6
#: Largest output or sensitivity, in any unit, that counts as a prediction: the square of a larger one overflows.
MAX_MAGNITUDE = 1e100


@dataclass(frozen=True, eq=False)
class Series:
    """The readings of one output in one recording: experiment, column, sample times and values."""

    experiment: int
    column: int
    output: str
    sampling: SampleTimes
    measured: FloatArray


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A model compared with the data at one parameter vector.

    ``predicted`` and ``residual`` have one array (n,) a series; ``slopes`` one array (k, n) a series, the derivative
    of the prediction by the search coordinates of the k active columns, or None.
    """

    predicted: tuple[FloatArray, ...]
    residual: tuple[FloatArray, ...]
    slopes: tuple[FloatArray, ...] | None


@dataclass(frozen=True, eq=False)
class Whitened:
    """Whitened residual (N,) and sensitivities (k, N), all series end to end, of ``readings`` readings."""

    residual: FloatArray
    slopes: FloatArray
    log_determinant: float
    readings: int

    @property
    def log_likelihood(self) -> float:
        return -0.5 * (float(self.residual @ self.residual) + self.log_determinant + self.readings * LOG_2PI)


class Objective:
    """The likelihood of one calibration as a function of its parameters.

    Parameters
    ----------
    calibration : Calibration
    simulator : Simulator
        Of the calibration's problem.
    outputs : sequence of str, optional
        Outputs that count; all by default.
    outcomes : Counter, optional
        Counts simulations by their outcome; shared between objectives of one search.
    result_cache : ResultCache, optional
        Keeps the results of searches.
    """

    def __init__(
        self,
        calibration: Calibration,
        simulator: Simulator,
        *,
        outputs: Sequence[str] | None = None,
        outcomes: Counter[Outcome] | None = None,
        result_cache: ResultCache | None = None,
    ) -> None:
        self.calibration, self.simulator, self.result_cache = calibration, simulator, result_cache
        self.parameters = calibration.parameters
        self.outputs = tuple(o for o in calibration.outputs if outputs is None or o in outputs)
        self.series = tuple(s for s in _series(calibration) if s.output in self.outputs)
        self.outcomes: Counter[Outcome] = Counter() if outcomes is None else outcomes

    def with_outputs(self, outputs: Sequence[str]) -> Objective:
        """The objective of some of the outputs."""
        return self.with_calibration(self.calibration, self.simulator, outputs)

    def with_calibration(
        self, calibration: Calibration, simulator: Simulator, outputs: Sequence[str] | None = None
    ) -> Objective:
        """Another calibration, its simulations counted and its searches kept where those of this one are."""
        return Objective(
            calibration, simulator, outputs=outputs, outcomes=self.outcomes, result_cache=self.result_cache
        )

    def cached(self, kind: str, arguments: Sequence[object], work: Callable[[], Arrays]) -> Arrays:
        """The result of ``work``, from the cache if it is there (memoised by kind, calibration and arguments).

        ``work`` must depend on nothing else. Its simulations are counted either way.
        """
        if self.result_cache is None:
            return work()
        key = digest(kind, self.calibration.identity, self.outputs, arguments)
        found = self.result_cache.get(key)
        if found is None:
            before = Counter(self.outcomes)
            found = work()
            spent = [(int(outcome), count) for outcome, count in (self.outcomes - before).items()]
            self.result_cache.put(key, {**found, "spent": np.array(spent, dtype=np.int64).reshape(-1, 2)})
        else:
            self.outcomes.update({Outcome(outcome): count for outcome, count in found["spent"].tolist()})
        return found

    @property
    def readings(self) -> int:
        """Number of readings."""
        return sum(series.sampling.size for series in self.series)

    @property
    def simulations(self) -> int:
        return self.outcomes.total()

    @property
    def failures(self) -> int:
        return self.outcomes.total() - self.outcomes[Outcome.OK]

    @property
    def commonest_failure(self) -> str:
        """The most frequent reason why simulations failed, in words."""
        failed = {outcome: count for outcome, count in self.outcomes.items() if outcome is not Outcome.OK and count}
        return max(failed, key=lambda outcome: failed[outcome]).text if failed else "no reason given"

    # by residuals

    def evaluate(self, coordinates: FloatArray, active: Sequence[int] | None = None) -> Evaluation | None:
        """Compare one parameter vector (search coordinates) with the data; None if a simulation failed or diverged."""
        values = self.parameters.from_search(coordinates)
        if active is not None:
            values = self.parameters.away_from_zero(values, active)
        found = self.simulate(values[np.newaxis, :], active=list(active) if active is not None else None)
        if np.any(found.outcomes[0] != Outcome.OK):
            return None
        scale = self.parameters.jacobian(values)[list(active)] if active is not None else None
        predicted, residual, slopes = [], [], []
        for series in self.series:
            index = series.sampling.index
            y = found.outputs[series.experiment][0, index, series.column]
            predicted.append(y)
            residual.append(series.measured - y)
            if scale is not None:
                assert found.sensitivities is not None
                by = found.sensitivities[series.experiment][0, :, series.column, :][index]
                slopes.append(np.ascontiguousarray(by.T) * scale[:, np.newaxis])
        if any(np.max(np.abs(rows), initial=0.0) > MAX_MAGNITUDE for rows in (*residual, *slopes)):
            return None
        return Evaluation(tuple(predicted), tuple(residual), tuple(slopes) if scale is not None else None)

    def residuals(self, coordinates: FloatArray) -> list[tuple[FloatArray, ...] | None]:
        """Residuals of several parameter vectors (rows), one array a series; None where a simulation failed."""
        found = self.simulate(self.parameters.from_search(coordinates))
        return [
            tuple(s.measured - found.outputs[s.experiment][k, s.sampling.index, s.column] for s in self.series)
            if np.all(found.outcomes[k] == Outcome.OK)
            else None
            for k in range(len(coordinates))
        ]

    def whiten(
        self, residual: Sequence[FloatArray], slopes: Sequence[FloatArray] | None, noise: Mapping[str, OutputNoise]
    ) -> Whitened:
        """Whiten residual and sensitivities by the noise of each output."""
        white, by, log_det = [], [], 0.0
        for k, series in enumerate(self.series):
            rows = residual[k][np.newaxis, :]
            if slopes is not None:
                rows = np.concatenate((rows, slopes[k]))
            out, det = whiten(rows, series.sampling, noise[series.output])
            log_det += det
            white.append(out[0])
            by.append(out[1:])
        return Whitened(np.concatenate(white), np.concatenate(by, axis=1), log_det, self.readings)

    # reduced in the engine

    def simulate(self, values: FloatArray, active: Sequence[int] | None = None) -> Trajectories:
        """Trajectories of SI values (n, p)."""
        found = self.simulator.simulate(values, active=active)
        self._count(found.outcomes)
        return found

    def log_likelihood(self, values: FloatArray, noise: FloatArray) -> FloatArray:
        """Log-likelihood of each experiment at SI values (n, p), shape (n, E); minus infinity where the run failed."""
        found = self.simulator.log_likelihood(values, noise)
        self._count(found.outcomes)
        return found.log_likelihood

    def gauss_newton(self, values: FloatArray, noise: FloatArray, active: Sequence[int]) -> GaussNewton:
        """Likelihood, gradient and Gauss-Newton Hessian at SI values (n, p), by SI values."""
        found = self.simulator.gauss_newton(self.parameters.away_from_zero(values, active), noise, active=active)
        self._count(found.outcomes)
        return found

    def noise_rows(self, noise: Mapping[str, OutputNoise]) -> FloatArray:
        """Noise triples as the engine takes them, shape (1, 1, m, 3); outputs that do not count get large noise."""
        scale = self.calibration.scale
        rows = [
            noise[name].as_row() if name in self.outputs else (IGNORED_NOISE_FACTOR * float(scale[k]), 0.0, 0.0)
            for k, name in enumerate(self.calibration.outputs)
        ]
        return np.array([[rows]])

    def _count(self, outcomes: NDArray[np.uint8]) -> None:
        codes, counts = np.unique(outcomes, return_counts=True)
        for code, count in zip(codes.tolist(), counts.tolist(), strict=True):
            self.outcomes[Outcome(code)] += count


def _series(calibration: Calibration) -> list[Series]:
    found = []
    for e, (experiment, measured) in enumerate(zip(calibration.experiments, calibration.measured, strict=True)):
        for column, output in enumerate(experiment.outputs):
            values = measured[:, column]
            sampling = SampleTimes.of(experiment.time, values)
            if sampling.size > 1:
                found.append(Series(e, column, output, sampling, values[sampling.index]))
    return found
