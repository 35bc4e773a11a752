"""One model on one recording: parameter values in, outputs and Eq. 6 out, failures counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.cost import eq6
from aero_bayes.simulation import Outcome, Simulator

#: Standard deviation, in units of the fitted output's, of outputs that a reduced call shall leave out.
IGNORED = 1e9


class ModelEvaluator:
    """One model on the recording of a problem with one experiment.

    Parameters
    ----------
    simulator : Simulator
        Opened on a problem with one experiment, a column for each value of ``start``.
    start : mapping of str to float
        Values of all columns, in the problem's order, where nothing else is said.
    """

    def __init__(self, simulator: Simulator, start: Mapping[str, float]) -> None:
        self.simulator = simulator
        self.names = tuple(start)
        self.start = dict(start)
        self.outcomes: Counter[Outcome] = Counter()
        experiment = simulator.problem.experiments[0]
        if experiment.measured is None:
            raise CannotFinishError("the replay needs a recording with readings")
        self.time, self.outputs, self.measured = experiment.time, experiment.outputs, experiment.measured

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the columns' values, shape (p,), with the starting ones where none is given."""
        return np.array([values.get(name, self.start[name]) for name in self.names])

    def simulate(self, values: FloatArray) -> FloatArray:
        """Simulate a batch (n, p): outputs of shape (n, samples, m), NaN where a run failed."""
        found = self.simulator.simulate(np.atleast_2d(values))
        self.outcomes.update(map(Outcome, found.outcomes.ravel().tolist()))
        outputs = found.outputs[0].copy()
        outputs[found.outcomes[:, 0] != Outcome.OK] = np.nan
        return outputs

    def cost(self, values: FloatArray, output: str) -> FloatArray:
        """Compute Eq. 6 of one output for a batch (n, p): shape (n,), infinite where a run failed."""
        k = self.outputs.index(output)
        runs = self.simulate(values)[:, :, k]
        costs = [eq6([(self.measured[:, k] - y)[:, None]]) if np.isfinite(y).all() else np.inf for y in runs]
        return np.array(costs)

    def slopes(self, values: FloatArray, output: str, active: Sequence[int]) -> FloatArray:
        """Compute the exact derivative of Eq. 6 of one output by the active columns, shape (a,)."""
        cost, gradient, _ = self.products(values[None, :], output, active)
        if not np.isfinite(cost[0]):
            raise CannotFinishError(f"the model cannot be simulated at {dict(zip(self.names, values, strict=True))}")
        return np.asarray(2.0 * gradient[0])

    def products(
        self, values: FloatArray, output: str, active: Sequence[int]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute half of Eq. 6 of an output, its gradient and Gauss-Newton Hessian: (n,), (n, a), (n, a, a).

        Derivatives are by SI values. The cost is infinite where a run failed.
        """
        noise = np.zeros((1, 1, len(self.outputs), 3))
        noise[..., 0] = IGNORED * np.maximum(np.nanmax(np.abs(self.measured), axis=0), 1.0)
        noise[0, 0, self.outputs.index(output), 0] = 1.0
        found = self.simulator.gauss_newton(values, noise, active=list(active))
        self.outcomes.update(map(Outcome, found.outcomes.ravel().tolist()))
        good = np.isfinite(found.cost) & np.all(found.outcomes == Outcome.OK, axis=1)
        return (
            np.where(good, found.cost, np.inf),
            np.where(good[:, None], found.gradient, 0.0),
            np.where(good[:, None, None], found.hessian, 0.0),
        )
