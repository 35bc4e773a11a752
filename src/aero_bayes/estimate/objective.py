"""The likelihood of a calibration: its residuals, whitened; with process noise those of a filter."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import Arrays, ResultCache, digest
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import OutputNoise, SampleTimes
from aero_bayes.estimate.noise_estimation import LOG_2PI, reading_log_density, whiten
from aero_bayes.simulation.interface import (
    Outcome,
    ReadingNoiseTarget,
    Simulator,
    SmoothedStates,
    Trajectories,
    smooth,
)
from aero_bayes.simulation.native_simulator import NativeSimulator

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
    of the prediction by the search coordinates of the k active columns, or None."""

    predicted: tuple[FloatArray, ...]
    residual: tuple[FloatArray, ...]
    slopes: tuple[FloatArray, ...] | None
    sd: tuple[FloatArray, ...] | None = None
    log_sd_slopes: tuple[FloatArray, ...] | None = None


@dataclass(frozen=True, eq=False)
class Whitened:
    """Whitened residual (N,) and sensitivities (k, N), all series end to end, of ``readings`` readings.

    ``log_sd_slopes`` (k, N) is there where the columns move the predictions' standard deviations, too."""

    residual: FloatArray
    slopes: FloatArray
    log_determinant: float
    readings: int
    log_sd_slopes: FloatArray | None = None

    @property
    def log_likelihood(self) -> float:
        return -0.5 * (float(self.residual @ self.residual) + self.log_determinant + self.readings * LOG_2PI)

    @property
    def score(self) -> FloatArray:
        """Gradient (k,) of the log-likelihood."""
        score = self.slopes @ self.residual
        return score if self.log_sd_slopes is None else score + self.log_sd_slopes @ (self.residual**2 - 1.0)

    @property
    def information(self) -> FloatArray:
        """Fisher information (k, k), expected over readings that the model predicts rightly."""
        information = self.slopes @ self.slopes.T
        if self.log_sd_slopes is None:
            return information
        return information + 2.0 * self.log_sd_slopes @ self.log_sd_slopes.T


class Objective:
    """The likelihood of one calibration as a function of its parameters; see :func:`objective_of`."""

    #: Whether predictions are a filter's, of each reading from those before it: then the noise is among the parameters.
    filters: ClassVar[bool] = False

    def __init__(
        self,
        calibration: Calibration,
        simulator: Simulator,
        *,
        outputs: Sequence[str] | None = None,
        outcomes: Counter[Outcome] | None = None,
        result_cache: ResultCache | None = None,
    ) -> None:
        if (calibration.process is not None) != self.filters:
            raise TypeError("process noise needs a FilterObjective, and only that: use objective_of")
        self.calibration, self.simulator, self.result_cache = calibration, simulator, result_cache
        self.parameters = calibration.parameters
        self.outputs = tuple(o for o in calibration.data.outputs if outputs is None or o in outputs)
        self.series = tuple(s for s in _series(calibration.data) if s.output in self.outputs)
        self.outcomes: Counter[Outcome] = Counter() if outcomes is None else outcomes

    def with_outputs(self, outputs: Sequence[str]) -> Objective:
        """Return the objective of some of the outputs."""
        return self.with_calibration(self.calibration, self.simulator, outputs)

    def with_calibration(
        self, calibration: Calibration, simulator: Simulator, outputs: Sequence[str] | None = None
    ) -> Objective:
        """Return the objective of another calibration; simulations count and searches are kept where this one does."""
        return type(self)(
            calibration, simulator, outputs=outputs, outcomes=self.outcomes, result_cache=self.result_cache
        )

    def cached(
        self,
        kind: str,
        arguments: Sequence[object],
        work: Callable[[], Arrays],
        complete: Callable[[], bool] = lambda: True,
    ) -> Arrays:
        """Return the result of ``work``, from the cache if it is there (memoised by kind, calibration and arguments).

        ``work`` must depend on nothing else. Its simulations are counted either way. A result is kept only if it is
        ``complete``."""
        if self.result_cache is None:
            return work()
        key = digest(kind, self.calibration.identity, self.outputs, arguments)
        found = self.result_cache.get(key)
        if found is None:
            before = Counter(self.outcomes)
            found = work()
            spent = [(int(outcome), count) for outcome, count in (self.outcomes - before).items()]
            if complete():
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
        if not failed:
            return "no reason given"
        words = getattr(self.simulator, "words", "")
        return max(failed, key=lambda outcome: failed[outcome]).text + (f" ({words})" if words else "")

    # by residuals

    def evaluate(self, coordinates: FloatArray, active: Sequence[int] | None = None) -> Evaluation | None:
        """Compare one parameter vector (search coordinates) with the data; None if a simulation failed or diverged."""
        values = self.parameters.from_search(coordinates)
        if active is not None:
            values = self.parameters.away_from_zero(values, active)
        found = self._compare(values, active)
        if found is None or any(
            not np.max(np.abs(rows), initial=0.0) <= MAX_MAGNITUDE for rows in (*found.residual, *(found.slopes or ()))
        ):
            return None
        return found

    def _compare(self, values: FloatArray, active: Sequence[int] | None) -> Evaluation | None:
        found = self.simulate(values[np.newaxis, :], active=list(active) if active is not None else None)
        if np.any(found.outcomes[0] != Outcome.OK):
            return None
        slopes = None
        if active is not None:
            assert found.sensitivities is not None
            scale = self.parameters.jacobian(values)[list(active)][:, np.newaxis]
            by = [found.sensitivities[s.experiment][0, s.sampling.index, s.column, :] for s in self.series]
            slopes = tuple(np.ascontiguousarray(rows.T) * scale for rows in by)
        return self._evaluation([y[0] for y in found.outputs], slopes)

    def _evaluation(self, outputs: Sequence[FloatArray], slopes: tuple[FloatArray, ...] | None = None) -> Evaluation:
        """Compare outputs (n, m) of each experiment with the readings."""
        predicted = tuple(outputs[s.experiment][s.sampling.index, s.column] for s in self.series)
        residual = tuple(s.measured - y for s, y in zip(self.series, predicted, strict=True))
        return Evaluation(predicted, residual, slopes)

    def residuals(self, coordinates: FloatArray) -> list[Evaluation | None]:
        """Compare several parameter vectors (rows) with the data, without slopes; None where one failed."""
        found = self.simulate(self.parameters.from_search(coordinates))
        return [
            self._evaluation([y[k] for y in found.outputs]) if np.all(found.outcomes[k] == Outcome.OK) else None
            for k in range(len(coordinates))
        ]

    def levels(self, coordinates: FloatArray, noise: Mapping[str, OutputNoise]) -> list[float]:
        """Compute the log-likelihood of parameter vectors (rows) under some noise; minus infinity where one failed."""
        found = self.residuals(coordinates)
        return [-np.inf if one is None else self.whiten(one, noise).log_likelihood for one in found]

    def whiten(self, found: Evaluation, noise: Mapping[str, OutputNoise]) -> Whitened:
        """Whiten residual and sensitivities by the noise of each output."""
        residual, slopes = found.residual, found.slopes
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

    def predictions(self, values: FloatArray) -> tuple[FloatArray, ...]:
        """Compute outputs (n, m) of each experiment at SI values (p,)."""
        return tuple(y[0] for y in self.simulate(values[np.newaxis, :]).outputs)

    def smoothed_states(self, values: FloatArray) -> tuple[SmoothedStates, ...]:
        """Compute states of each recording at SI values (p,) given all its readings: none without process noise."""
        return ()

    def reading_noise(self, coordinates: FloatArray) -> dict[str, OutputNoise]:
        """Return the outputs' noise that is searched, at search coordinates (p,): none without process noise."""
        return {}

    def by_output(self, rows: FloatArray) -> dict[str, FloatArray]:
        """Join the values (N,) of all series end to end, by output."""
        parts: dict[str, list[FloatArray]] = {output: [] for output in self.outputs}
        ends = np.cumsum([series.sampling.size for series in self.series])
        for series, values in zip(self.series, np.split(rows, ends[:-1]), strict=True):
            parts[series.output].append(values)
        return {output: np.concatenate([*values, np.zeros(0)]) for output, values in parts.items()}

    # reduced in the engine

    def simulate(self, values: FloatArray, active: Sequence[int] | None = None) -> Trajectories:
        """Simulate SI values (n, p)."""
        found = self.simulator.simulate(values, active=active)
        self._count(found.outcomes)
        return found

    def log_likelihood(self, values: FloatArray, noise: FloatArray) -> FloatArray:
        """Compute the log-likelihood of each experiment at SI values (n, p), shape (n, E).

        Minus infinity for a failed run. The compiled engine sums it up itself."""
        if isinstance(self.simulator, NativeSimulator):
            found = self.simulator.log_likelihood(values, noise)
            self._count(found.outcomes)
            return found.log_likelihood
        run = self.simulate(values)
        total = np.zeros(run.outcomes.shape)
        noise = np.broadcast_to(noise, (*total.shape, len(self.calibration.data.outputs), 3))
        for s in self.series:
            rows = s.sampling.equalised(s.measured - run.outputs[s.experiment][:, s.sampling.index, s.column])
            density = reading_log_density(s.sampling.time, rows, noise[:, s.experiment, s.column])
            total[:, s.experiment] += np.sum(density, axis=1)
            if s.sampling.spread is not None:
                total[:, s.experiment] -= np.sum(np.log(s.sampling.spread))
        return np.where(run.outcomes == Outcome.OK, total, -np.inf)

    def noise_rows(self, noise: Mapping[str, OutputNoise]) -> FloatArray:
        """Write noise triples as the engine takes them, shape (1, 1, m, 3)."""
        return np.array([[[noise[name].as_row() for name in self.calibration.data.outputs]]])

    def _count(self, outcomes: NDArray[np.uint8]) -> None:
        codes, counts = np.unique(outcomes, return_counts=True)
        for code, count in zip(codes.tolist(), counts.tolist(), strict=True):
            self.outcomes[Outcome(code)] += count


def _series(data: MeasuredData) -> list[Series]:
    found = []
    for e, (experiment, measured) in enumerate(zip(data.experiments, data.measured, strict=True)):
        for column, output in enumerate(experiment.outputs):
            values = measured[:, column]
            spread = None if experiment.spread is None else experiment.spread[:, column]
            sampling = SampleTimes.of(experiment.time, values, spread)
            if sampling.size > 1:
                found.append(Series(e, column, output, sampling, values[sampling.index]))
    return found


def objective_of(
    calibration: Calibration, simulator: Simulator, *, result_cache: ResultCache | None = None
) -> Objective:
    """Compare a calibration with its recordings, by a filter where it has process noise."""
    kind = Objective if calibration.process is None else FilterObjective
    return kind(calibration, simulator, result_cache=result_cache)


class FilterObjective(Objective):
    """The likelihood of a calibration with process noise: residuals are a filter's innovations."""

    filters: ClassVar[bool] = True

    def _compare(self, values: FloatArray, active: Sequence[int] | None) -> Evaluation | None:
        columns = list(active) if active is not None else []
        found = cast(NativeSimulator, self.simulator).filter(values[np.newaxis, :], active=columns)
        self._count(found.outcomes)
        if np.any(found.outcomes[0] != Outcome.OK):
            return None
        scale = self.parameters.jacobian(values)[columns][:, np.newaxis]
        sd, slopes, log_sd_slopes = [], [], []
        for s in self.series:
            variance = found.variance[s.experiment][0, s.sampling.index, s.column]
            by, variance_by = (a[s.experiment][0, s.sampling.index, s.column].T for a in (
                found.predicted_slopes, found.variance_slopes
            ))  # fmt: skip
            sd.append(np.sqrt(variance))
            slopes.append(by * scale)
            log_sd_slopes.append(variance_by * scale / (2.0 * variance))
        plain = replace(self._evaluation([y[0] for y in found.predicted]), sd=tuple(sd))
        return plain if active is None else replace(plain, slopes=tuple(slopes), log_sd_slopes=tuple(log_sd_slopes))

    def residuals(self, coordinates: FloatArray) -> list[Evaluation | None]:
        return [self.evaluate(row) for row in coordinates]

    def whiten(self, found: Evaluation, noise: Mapping[str, OutputNoise]) -> Whitened:
        """Divide innovations and sensitivities by the filter's own standard deviations."""
        assert found.sd is not None
        width = np.concatenate(found.sd)
        slopes, by_width = np.zeros((0, self.readings)), None
        if found.slopes is not None and found.log_sd_slopes is not None:
            slopes, by_width = (np.concatenate(rows, axis=1) for rows in (found.slopes, found.log_sd_slopes))
        log_det = 2.0 * float(np.sum(np.log(width)))
        return Whitened(np.concatenate(found.residual) / width, slopes / width, log_det, self.readings, by_width)

    def reading_noise(self, coordinates: FloatArray) -> dict[str, OutputNoise]:
        values = self.parameters.from_search(coordinates)
        return {
            p.target.output: OutputNoise(float(value), white_identified=False)
            for p, value in zip(self.parameters, values, strict=True)
            if isinstance(p.target, ReadingNoiseTarget)
        }

    def predictions(self, values: FloatArray) -> tuple[FloatArray, ...]:
        found = cast(NativeSimulator, self.simulator).filter(values[np.newaxis, :])
        self._count(found.outcomes)
        return tuple(y[0] for y in found.predicted)

    def smoothed_states(self, values: FloatArray) -> tuple[SmoothedStates, ...]:
        found = cast(NativeSimulator, self.simulator).filtered_states(values)
        self._count(np.zeros(len(found), dtype=np.uint8))
        return tuple(smooth(states, y) for states, y in zip(found, self.calibration.data.measured, strict=True))
