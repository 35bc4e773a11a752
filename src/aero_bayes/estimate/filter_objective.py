"""The likelihood with process noise: a filter predicts each reading from those before it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import ClassVar, cast

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import ResultCache
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.objective import Evaluation, Objective, Whitened
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation.interface import Filter, GaussNewton, Outcome, ReadingNoiseTarget, Simulator
from aero_bayes.simulation.smoothing import SmoothedStates, smooth


def objective_of(
    calibration: Calibration, simulator: Simulator, *, result_cache: ResultCache | None = None
) -> Objective:
    """Compare a calibration with its recordings, by a filter where it has process noise."""
    kind = Objective if calibration.simulated.process is None else FilterObjective
    return kind(calibration, simulator, result_cache=result_cache)


class FilterObjective(Objective):
    """The likelihood of a calibration with process noise: residuals are a filter's innovations."""

    filters: ClassVar[bool] = True

    def _compare(self, values: FloatArray, active: Sequence[int] | None) -> Evaluation | None:
        columns = list(active) if active is not None else []
        found = cast(Filter, self.simulator).filter(values[np.newaxis, :], active=columns)
        self._count(found.outcomes)
        if np.any(found.outcomes[0] != Outcome.OK):
            return None
        scale = self.parameters.jacobian(values)[columns][:, np.newaxis]
        predicted, sd, slopes, log_sd_slopes = [], [], [], []
        for s in self.series:
            variance = found.variance[s.experiment][0, s.sampling.index, s.column]
            by, variance_by = (a[s.experiment][0, s.sampling.index, s.column].T for a in (
                found.predicted_slopes, found.variance_slopes
            ))  # fmt: skip
            predicted.append(found.predicted[s.experiment][0, s.sampling.index, s.column])
            sd.append(np.sqrt(variance))
            slopes.append(by * scale)
            log_sd_slopes.append(variance_by * scale / (2.0 * variance))
        residual = tuple(s.measured - y for s, y in zip(self.series, predicted, strict=True))
        if active is None:
            return Evaluation(tuple(predicted), residual, None, tuple(sd))
        return Evaluation(tuple(predicted), residual, tuple(slopes), tuple(sd), tuple(log_sd_slopes))

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
        found = cast(Filter, self.simulator).filter(values[np.newaxis, :])
        self._count(found.outcomes)
        return tuple(y[0] for y in found.predicted)

    def smoothed_states(self, values: FloatArray) -> tuple[SmoothedStates, ...]:
        found = cast(Filter, self.simulator).filtered_states(values)
        self._count(np.zeros(len(found), dtype=np.uint8))
        return tuple(smooth(states, y) for states, y in zip(found, self.calibration.data.measured, strict=True))

    def gauss_newton(self, values: FloatArray, noise: FloatArray, active: Sequence[int]) -> GaussNewton:
        n, q = len(values), len(active)
        result = GaussNewton(
            np.full(n, np.inf), np.full((n, q), np.nan), np.full((n, q, q), np.nan), np.full(n, -np.inf),
            np.zeros((n, len(self.calibration.data.experiments)), dtype=np.uint8),
        )  # fmt: skip
        for k, coordinates in enumerate(self.parameters.to_search(values)):
            before = Counter(self.outcomes)
            found = self.evaluate(coordinates, active)
            result.outcomes[k] = max((self.outcomes - before).elements())
            if found is None:
                continue
            white = self.whiten(found, {})
            by = 1.0 / self.parameters.jacobian(values[k])[list(active)]
            result.cost[k] = 0.5 * float(white.residual @ white.residual)
            result.log_likelihood[k] = white.log_likelihood
            result.gradient[k], result.hessian[k] = -white.score * by, white.information * np.outer(by, by)
        return result
