"""Linearised response of a fitted model: gain of a change of the outputs, the free parameters readjusted to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.delays import delay_columns
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Evaluation, Objective
from aero_bayes.estimate.parameters import prior_curvature
from aero_bayes.laws.model_family import CandidateTerm

#: Coordinates of a simulated point, and how it compares with the data.
SimulatedPoint = tuple[FloatArray, Evaluation]

#: Smallest and largest step along a line, as multiples of the step that was simulated.
MIN_STEP_RATIO, MAX_STEP_RATIO = 0.05, 3.0


@dataclass(frozen=True, eq=False)
class ResponseLine:
    """The straight line from a fit through a tried point, in the space of whitened residuals."""

    point: FloatArray
    readjustment: FloatArray
    squared_length: float
    length_before: float
    best_step: float

    @property
    def bounded_step(self) -> float:
        """The best step, limited to the range where the line is trusted."""
        return float(np.clip(self.best_step, MIN_STEP_RATIO, MAX_STEP_RATIO))

    def gain(self, step: float) -> float:
        """Gain in log-likelihood that the line predicts for a step."""
        return (self.best_step - 0.5 * step) * step * self.squared_length

    @property
    def best_gain(self) -> float:
        """Predicted gain at the best step; zero if the best step is negative."""
        return self.gain(max(self.best_step, 0.0))


class LinearResponse:
    """Gauss-Newton readjustment of the free parameters about a point."""

    def __init__(self, objective: Objective, base: Optimum) -> None:
        self.objective, self.base = objective, base
        slopes, residual, free = base.whitened.slopes, base.whitened.residual, list(base.free)
        first, second = (d[free] for d in objective.parameters.prior_derivatives(base.coordinates))
        delays = delay_columns(objective, free)
        steady = [k for k, j in enumerate(free) if j not in delays]
        own = slopes[steady]
        curvature = own @ own.T + prior_curvature(second[steady])
        # Where parameters cannot be told apart, the smallest step that does, in units of what each is known to.
        unit = 1.0 / np.sqrt(np.diag(curvature))
        both = np.outer(unit, unit)
        self._step = np.zeros((len(free), len(free)))
        self._step[np.ix_(steady, steady)] = np.linalg.pinv(curvature * both, 1e-10, hermitian=True) * both
        self.free_step: FloatArray = self._step @ (slopes @ residual + first)
        self.remaining: FloatArray = residual - self.free_step @ slopes

    def gain_under_white_noise(self, gain: float) -> float:
        """Return a predicted gain in log-likelihood if the rest of the residual were white noise.

        Under the present noise, which includes the structure of the residual, no gain exceeds half of the effective
        samples. Under the noise that the right term leaves it may be much larger."""
        whole = 0.5 * float(self.base.whitened.residual @ self.base.whitened.residual)
        share = min(gain / max(whole, 1e-300), 1.0 - 1e-9)
        return -0.5 * self.base.whitened.readings * math.log1p(-share)

    def simulate(self, columns: Sequence[int], values: Sequence[tuple[float, ...]]) -> list[SimulatedPoint]:
        """Points with some columns at each of several SI values, all else as in the fit, and the residuals there."""
        if not len(values):
            return []
        parameters, at = self.objective.parameters, self.base.coordinates
        si = np.repeat(parameters.from_search(at)[np.newaxis, :], len(values), axis=0)
        si[:, list(columns)] = values
        rows = np.repeat(at[np.newaxis, :], len(values), axis=0)
        rows[:, list(columns)] = np.array([parameters.to_search(v)[list(columns)] for v in si])
        found = self.objective.residuals(rows)
        return [(row, tried) for row, tried in zip(rows, found, strict=True) if tried is not None]

    def line(self, row: FloatArray, tried: Evaluation) -> ResponseLine:
        """From the fit to a point that was compared with the data."""
        whitened = self.base.whitened
        change = whitened.residual - self.objective.whiten(tried, self.base.noise).residual
        back = self._step @ (whitened.slopes @ change)
        direction = change - back @ whitened.slopes
        power = float(direction @ direction)
        along = float(direction @ self.remaining) / power if power > 0.0 else 0.0
        return ResponseLine(row, back, power, math.sqrt(float(change @ change)), along)

    def point_on_line(
        self, candidate: CandidateTerm, line: ResponseLine, step: float, readjusted: bool = True
    ) -> FloatArray:
        """Search coordinates after a step along a line, the free parameters ``readjusted`` to it."""
        low, high = self.objective.parameters.box
        size, free = candidate.columns[0], list(self.base.free)
        point = line.point.copy()
        point[size] = np.clip(step * line.point[size], low[size], high[size])
        if readjusted:
            point[free] = np.clip(
                self.base.coordinates[free] + self.free_step - step * line.readjustment, low[free], high[free]
            )
        return point

    def simulated_gains(self, points: Sequence[FloatArray]) -> list[float]:
        """Gain in log-likelihood at points, by simulation; minus infinity where that fails."""
        found = self.objective.residuals(np.array(points)) if len(points) else []
        present = self.base.whitened.log_likelihood
        return [
            -math.inf if tried is None else self.objective.whiten(tried, self.base.noise).log_likelihood - present
            for tried in found
        ]  # fmt: skip

    def readjusted_slopes(
        self, point: FloatArray, columns: Sequence[int]
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Slopes by further columns, before and after the free parameters have readjusted."""
        free, own = list(self.base.free), self.base.whitened.slopes
        found = self.objective.evaluate(point, [*free, *columns])
        if found is None or found.slopes is None:
            return None
        new = self.objective.whiten(found, self.base.noise).slopes[len(free) :]
        back = (new @ own.T) @ self._step
        return new - back @ own, new, back
