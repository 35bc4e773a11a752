"""The paper's two searches with their faults, for the replay of its Table 1 beside the same runs done right.

RaPId's particle swarm searches linear axes in SI units with few particles, so that a parameter of size 1e-6 with wide
bounds is never looked for where it is. Its call of fmincon differentiates with a step of 0.1 in *absolute* terms, which
leaves the neighbourhood of a parameter of size 1e-6 altogether: the slope it sees is that of another model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from aero_bayes.inference import pso
from aero_bayes.inference.calibration import Calibration
from aero_bayes.simulation.interface import Simulator

FloatArray = NDArray[np.float64]


class Eq6Cost:
    """Sum of squared errors of some outputs (Podlaski et al., Eq. 6) over some columns in SI units.

    Parameters
    ----------
    calibration : Calibration
    simulator : Simulator
        Of the calibration's problem.
    columns : sequence of str
        Parameters that vary, in the order of the vectors this is called with.
    base : ndarray, shape (p,)
        SI values of all parameters.
    outputs : sequence of str, optional
        Outputs that count; all by default.
    """

    def __init__(
        self,
        calibration: Calibration,
        simulator: Simulator,
        columns: Sequence[str],
        base: FloatArray,
        outputs: Sequence[str] | None = None,
    ) -> None:
        self._simulator, self._base = simulator, np.asarray(base, dtype=np.float64)
        self._columns = [calibration.parameters.index(name) for name in columns]
        self._measured = calibration.measured
        wanted = calibration.outputs if outputs is None else outputs
        self._outputs = [calibration.outputs.index(name) for name in wanted]
        self.evaluations, self.failures = 0, 0

    def full(self, values: FloatArray) -> FloatArray:
        """SI values of all parameters, shape (n, p), for vectors (n, k)."""
        full = np.tile(self._base, (len(values), 1))
        full[:, self._columns] = values
        return full

    def __call__(self, values: FloatArray) -> FloatArray:
        """Costs of vectors (n, k), shape (n,); infinite where the simulation failed."""
        values = np.atleast_2d(values)
        result = self._simulator.simulate(self.full(values))
        total = np.zeros(len(values))
        for measured, fitted in zip(self._measured, result.outputs, strict=True):
            error = (measured - fitted)[:, :, self._outputs]
            seen = np.isfinite(measured[:, self._outputs])
            total += np.sum(np.where(seen, error, 0.0) ** 2, axis=(1, 2))
        total[~np.isfinite(total) | np.any(result.outcomes != 0, axis=1)] = np.inf
        self.evaluations += len(values)
        self.failures += int(np.sum(~np.isfinite(total)))
        return total


@dataclass(frozen=True)
class UnscaledResult:
    """Where an unscaled search ended: SI values (k,), Eq. 6 cost, and how it moved from its start."""

    values: FloatArray
    cost: float
    history: tuple[float, ...]
    evaluations: int
    text: str


def unscaled_swarm(
    cost: Eq6Cost,
    low: FloatArray,
    high: FloatArray,
    rng: np.random.Generator,
    *,
    particles: int = 8,
    iterations: int = 100,
) -> UnscaledResult:
    """A small swarm on linear axes; particles stop at the bounds."""
    settings = pso.SwarmSettings(particles, iterations, iterations, 0.0, reflect=False)
    result = pso.minimise(cost, low, high, rng, settings)
    return UnscaledResult(result.best, result.cost, result.history, result.evaluations, result.reason)


def absolute_gradient(cost: Eq6Cost, values: FloatArray, step: float) -> FloatArray:
    """Forward differences with one absolute step for every parameter; zero where the shifted model does not run."""
    here = np.asarray(values, dtype=np.float64)
    points = np.concatenate([here[None], here + step * np.eye(here.size)])
    costs = cost(points)
    slope = (costs[1:] - costs[0]) / step
    return np.where(np.isfinite(slope), slope, 0.0)


def unscaled_local(
    cost: Eq6Cost, start: FloatArray, low: FloatArray, high: FloatArray, *, step: float = 0.1, iterations: int = 100
) -> UnscaledResult:
    """Sequential quadratic programming on linear axes with slopes from an absolute step.

    ``step`` = 0.1 is RaPId's; a step in proportion to each parameter is what it should have been.
    """
    history: list[float] = []

    def value(x: FloatArray) -> float:
        found = float(cost(x[None])[0])
        history.append(min(found, history[-1]) if history else found)
        return found if np.isfinite(found) else 1e300

    result = minimize(
        value, np.asarray(start, dtype=np.float64), jac=lambda x: absolute_gradient(cost, x, step), method="SLSQP",
        bounds=list(zip(low, high, strict=True)), options={"maxiter": iterations, "ftol": 1e-9},
    )  # fmt: skip
    values = np.clip(np.asarray(result.x, dtype=np.float64), low, high)
    return UnscaledResult(values, float(cost(values[None])[0]), tuple(history), cost.evaluations, str(result.message))
