"""Recordings held against one model: residuals and sensitivities, output by output, in search coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.discrepancy.whitening import OutputNoise, Sampling, whiten
from aero_bayes.inference.parameters import ParameterSet
from aero_bayes.simulation.interface import Experiment, Outcome, Problem, Simulator, SolverSettings, Target
from aero_bayes.simulation.model import Model

FloatArray = NDArray[np.float64]


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
    """Residual and slopes in noise units, all series end to end: shapes (N,) and (k, N)."""

    residual: FloatArray
    slopes: FloatArray
    log_determinant: float

    @property
    def log_likelihood(self) -> float:
        n = self.residual.size
        return -0.5 * (float(self.residual @ self.residual) + self.log_determinant + n * float(np.log(2.0 * np.pi)))


def problem_of(
    model: Model,
    experiments: Sequence[Experiment],
    parameters: ParameterSet,
    fixed: Mapping[str, float],
    settings: SolverSettings,
) -> Problem:
    """What a simulator is asked: each parameter is a column; one of a single recording means nothing in the others."""
    targets: list[tuple[Target | None, ...]] = []
    for e in range(len(experiments)):
        targets.append(tuple(p.target if p.recording in (None, e) else None for p in parameters))
    return Problem(model, tuple(experiments), tuple(targets), dict(fixed), settings)


class Study:
    """One model, its simulator, and the recordings that it must repeat.

    Parameters
    ----------
    simulator : Simulator
        Opened on :func:`problem_of` these parameters; every experiment carries what was measured.
    parameters : ParameterSet
    """

    def __init__(self, simulator: Simulator, parameters: ParameterSet) -> None:
        self.simulator = simulator
        self.parameters = parameters
        self.experiments = simulator.problem.experiments
        self.series = tuple(_series(self.experiments))
        self.outputs = tuple(dict.fromkeys(series.output for series in self.series))
        self.simulations = 0
        self.failures = 0

    @property
    def size(self) -> int:
        """Number of readings."""
        return sum(series.sampling.size for series in self.series)

    def evaluate(self, coordinates: FloatArray, active: Sequence[int] | None = None) -> Evaluation | None:
        """Hold one parameter vector (search coordinates) against the data; None if a simulation failed."""
        values = self.parameters.from_search(coordinates)
        found = self.simulator.simulate(values[np.newaxis, :], active=list(active) if active is not None else None)
        self.simulations += len(self.experiments)
        if np.any(found.outcomes[0] != Outcome.OK):
            self.failures += 1
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
        return Evaluation(tuple(predicted), tuple(residual), tuple(slopes) if scale is not None else None)

    def residuals(self, coordinates: FloatArray) -> list[tuple[FloatArray, ...] | None]:
        """Residuals of several parameter vectors (rows), one array a series; None where a simulation failed."""
        values = self.parameters.from_search(coordinates)
        found = self.simulator.simulate(values)
        self.simulations += len(self.experiments) * len(values)
        rows: list[tuple[FloatArray, ...] | None] = []
        for k in range(len(values)):
            if np.any(found.outcomes[k] != Outcome.OK):
                self.failures += 1
                rows.append(None)
                continue
            rows.append(
                tuple(s.measured - found.outputs[s.experiment][k, s.sampling.index, s.column] for s in self.series)
            )
        return rows

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
        return Whitened(np.concatenate(white), np.concatenate(by, axis=1), log_det)

    def close(self) -> None:
        self.simulator.close()


def _series(experiments: Sequence[Experiment]) -> list[Series]:
    found = []
    for e, experiment in enumerate(experiments):
        if experiment.measured is None:
            continue
        for column, output in enumerate(experiment.outputs):
            values = experiment.measured[:, column]
            sampling = Sampling.of(experiment.time, values)
            if sampling.size > 1:
                found.append(Series(e, column, output, sampling, values[sampling.index]))
    return found
