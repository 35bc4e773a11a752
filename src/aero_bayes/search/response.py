"""The linearised response of a fitted model: what a change of the outputs gains once the free parameters readjust."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.delays import delay_columns
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Evaluation, Objective
from aero_bayes.estimate.parameters import prior_curvature
from aero_bayes.laws.model_family import CandidateTerm

FloatArray = NDArray[np.float64]
#: Coordinates of a simulated point, and how it compares with the data.
Tried = tuple[FloatArray, Evaluation]

#: Smallest and largest step along a line, as multiples of the step that was simulated.
MIN_STEP_RATIO, MAX_STEP_RATIO = 0.05, 3.0


@dataclass(frozen=True, eq=False)
class ResponseLine:
    """The straight line from a fit through a tried point, in the space of whitened residuals.

    Parameters
    ----------
    row : ndarray, shape (p,)
        Search coordinates of the tried point.
    back : ndarray, shape (f,)
        How far the free parameters readjust to the whole change.
    power : float
        Squared length of the change after they have readjusted.
    alone : float
        Length of the change before.
    along : float
        Step, in units of the tried one, at which the line comes closest to the readings.
    """

    row: FloatArray
    back: FloatArray
    power: float
    alone: float
    along: float

    @property
    def within(self) -> float:
        """The best step within reason."""
        return float(np.clip(self.along, MIN_STEP_RATIO, MAX_STEP_RATIO))

    def gain(self, step: float) -> float:
        """Gain in log-likelihood that a step foretells."""
        return (self.along - 0.5 * step) * step * self.power

    @property
    def best_gain(self) -> float:
        """The same at the best step; zero where the best step goes the wrong way."""
        return self.gain(max(self.along, 0.0))


class LinearResponse:
    """Gauss-Newton readjustment of the free parameters about a point.

    Parameters
    ----------
    objective : Objective
    base : Optimum
        An optimum, or another point that was evaluated with slopes.

    Notes
    -----
    With whitened residual ``r`` and slopes ``S`` the step of the free parameters is ``(S S' + P)^-1 S r``, where ``P``
    is the curvature of their priors. Delays are left out: readings move over a jump of the input all at once, which no
    slope describes.
    """

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
        self.own: FloatArray = self._step @ (slopes @ residual + first)
        self.left: FloatArray = residual - self.own @ slopes

    def possible(self, gain: float) -> float:
        """A gain in log-likelihood as it would be if all that is left beside it were white noise.

        Where structure is left, the noise is as large as that, and no gain can be larger than half of the effective
        samples; under the noise that a right term leaves it may be far more.
        """
        whole = 0.5 * float(self.base.whitened.residual @ self.base.whitened.residual)
        share = min(gain / max(whole, 1e-300), 1.0 - 1e-9)
        return -0.5 * self.base.whitened.readings * math.log1p(-share)

    def simulate(self, columns: Sequence[int], values: Sequence[tuple[float, ...]]) -> list[Tried]:
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
        along = float(direction @ self.left) / power if power > 0.0 else 0.0
        return ResponseLine(row, back, power, math.sqrt(float(change @ change)), along)

    def point(self, candidate: CandidateTerm, line: ResponseLine, step: float, readjusted: bool = True) -> FloatArray:
        """Search coordinates after a step along a line, the free parameters ``readjusted`` to it."""
        low, high = self.objective.parameters.box
        size, free = candidate.columns[0], list(self.base.free)
        point = line.row.copy()
        point[size] = np.clip(step * line.row[size], low[size], high[size])
        if readjusted:
            point[free] = np.clip(self.base.coordinates[free] + self.own - step * line.back, low[free], high[free])
        return point

    def gains(self, points: Sequence[FloatArray]) -> list[float]:
        """Gain in log-likelihood at points, by simulation; minus infinity where that fails."""
        found = self.objective.residuals(np.array(points)) if len(points) else []
        present = self.base.whitened.log_likelihood
        return [
            -math.inf if tried is None else self.objective.whiten(tried, self.base.noise).log_likelihood - present
            for tried in found
        ]  # fmt: skip

    def across(self, point: FloatArray, columns: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Slopes by further columns, before and after the free parameters have readjusted.

        Returns
        -------
        tuple of ndarray, optional
            The change by each column after (q, n) and before (q, n), and the readjustment (q, f); None where the point
            cannot be simulated.
        """
        free, own = list(self.base.free), self.base.whitened.slopes
        found = self.objective.evaluate(point, [*free, *columns])
        if found is None or found.slopes is None:
            return None
        new = self.objective.whiten(found, self.base.noise).slopes[len(free) :]
        back = (new @ own.T) @ self._step
        return new - back @ own, new, back
