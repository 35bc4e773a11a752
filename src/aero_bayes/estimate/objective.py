"""The objective: recordings held against one model, as residuals with their slopes or reduced inside the engine.

Both ways lead through the same calibration and the same noise, and agree (tested). A search that renews the noise
between its steps needs the residuals; a sampler, which asks for thousands of values, has them reduced in the engine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.checkpoint import Answers, Arrays, digest
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.sensors.innovations import LOG_2PI
from aero_bayes.sensors.noise import OutputNoise, Sampling, whiten
from aero_bayes.simulation.interface import GaussNewton, Outcome, Simulator, Trajectories

FloatArray = NDArray[np.float64]
#: What an output weighs that a stage leaves out: its range times this much noise.
IGNORED = 1e6
#: What is beyond it, in any unit, is no prediction, and has no square.
AWAY = 1e100


@dataclass(frozen=True, eq=False)
class Series:
    """One output of one recording: where it stands in the experiments, when it was read, what was read."""

    experiment: int
    column: int
    output: str
    sampling: Sampling
    measured: FloatArray


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A model held against the data.

    ``predicted`` and ``residual`` have one array (n,) a series; ``slopes`` one array (k, n) a series, the derivative
    of the prediction by the search coordinates of the k active columns, or None.
    """

    predicted: tuple[FloatArray, ...]
    residual: tuple[FloatArray, ...]
    slopes: tuple[FloatArray, ...] | None


@dataclass(frozen=True, eq=False)
class Whitened:
    """Residual and slopes in noise units, all series end to end: shapes (N,) and (k, N), for ``readings`` readings."""

    residual: FloatArray
    slopes: FloatArray
    log_determinant: float
    readings: int

    @property
    def log_likelihood(self) -> float:
        return -0.5 * (float(self.residual @ self.residual) + self.log_determinant + self.readings * LOG_2PI)


class Objective:
    """One calibration, its simulator, and what a parameter vector makes of them.

    Parameters
    ----------
    calibration : Calibration
    simulator : Simulator
        Of the calibration's problem.
    outputs : sequence of str, optional
        Outputs that count; all by default.
    outcomes : Counter, optional
        Where simulations are counted, shared with the objective that this one is a part of.
    answers : Answers, optional
        Where the ends of searches are kept.
    """

    def __init__(
        self,
        calibration: Calibration,
        simulator: Simulator,
        *,
        outputs: Sequence[str] | None = None,
        outcomes: Counter[Outcome] | None = None,
        answers: Answers | None = None,
    ) -> None:
        self.calibration, self.simulator, self.answers = calibration, simulator, answers
        self.parameters = calibration.parameters
        self.outputs = tuple(o for o in calibration.outputs if outputs is None or o in outputs)
        self.series = tuple(s for s in _series(calibration) if s.output in self.outputs)
        self.outcomes: Counter[Outcome] = Counter() if outcomes is None else outcomes

    def part(self, outputs: Sequence[str]) -> Objective:
        """The same with only some outputs counted."""
        return self.on(self.calibration, self.simulator, outputs)

    def on(self, calibration: Calibration, simulator: Simulator, outputs: Sequence[str] | None = None) -> Objective:
        """Another calibration, its simulations counted and its searches kept where those of this one are."""
        return Objective(calibration, simulator, outputs=outputs, outcomes=self.outcomes, answers=self.answers)

    def once(self, kind: str, asked: Sequence[object], work: Callable[[], Arrays]) -> Arrays:
        """What work finds that asks for nothing else than what is given; known already if it was kept.

        Its simulations count either way.
        """
        if self.answers is None:
            return work()
        key = digest(kind, self.calibration.identity, self.outputs, asked)
        found = self.answers.get(key)
        if found is None:
            before = Counter(self.outcomes)
            found = work()
            spent = [(int(outcome), count) for outcome, count in (self.outcomes - before).items()]
            self.answers.put(key, {**found, "spent": np.array(spent, dtype=np.int64).reshape(-1, 2)})
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
        """How most of the runs that failed ended, in words."""
        failed = {outcome: count for outcome, count in self.outcomes.items() if outcome is not Outcome.OK and count}
        return max(failed, key=lambda outcome: failed[outcome]).text if failed else "no reason given"

    # by residuals

    def evaluate(self, coordinates: FloatArray, active: Sequence[int] | None = None) -> Evaluation | None:
        """Hold one parameter vector (search coordinates) against the data; None if a simulation failed or ran away."""
        values = self.parameters.from_search(coordinates)
        if active is not None:
            values = self.parameters.awake(values, active)
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
        if any(np.max(np.abs(rows), initial=0.0) > AWAY for rows in (*residual, *slopes)):
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
        """Residual and slopes in units of the noise."""
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
        """Least-squares products at SI values (n, p) by SI values."""
        found = self.simulator.gauss_newton(self.parameters.awake(values, active), noise, active=active)
        self._count(found.outcomes)
        return found

    def noise_rows(self, noise: Mapping[str, OutputNoise]) -> FloatArray:
        """Noise triples as the engine takes them, shape (1, 1, m, 3); outputs that do not count get much of it."""
        scale = self.calibration.scale
        rows = [
            noise[name].as_row() if name in self.outputs else (IGNORED * float(scale[k]), 0.0, 0.0)
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
            sampling = Sampling.of(experiment.time, values)
            if sampling.size > 1:
                found.append(Series(e, column, output, sampling, values[sampling.index]))
    return found
