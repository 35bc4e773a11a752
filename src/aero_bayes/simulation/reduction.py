"""Likelihoods and Gauss-Newton products from whole trajectories, for simulators that cannot reduce inside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aero_bayes.simulation.gaussian import gauss_newton_products
from aero_bayes.simulation.interface import FloatArray, GaussNewton, Likelihoods, Outcome, Problem, Trajectories
from aero_bayes.simulation.problem_checks import check_noise, check_values


class ReducedTrajectories:
    """The reduced calls of a :class:`Simulator` that has ``problem`` and ``simulate``."""

    problem: Problem

    def simulate(self, values: FloatArray, *, active: Sequence[int] | None = None) -> Trajectories:
        """See :class:`Simulator`."""
        raise NotImplementedError

    def log_likelihood(self, values: FloatArray, noise: FloatArray) -> Likelihoods:
        """Gaussian log-likelihood of the measurements. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        noise = check_noise(self.problem, noise, len(values))
        found = self.simulate(values)
        result = np.full(found.outcomes.shape, -np.inf)
        for i, e in np.argwhere(found.outcomes == Outcome.OK):
            result[i, e] = self._products(e, found.outputs[e][i], None, noise[i, e])[3]
        return Likelihoods(result, found.outcomes)

    def gauss_newton(self, values: FloatArray, noise: FloatArray, *, active: Sequence[int]) -> GaussNewton:
        """Least-squares products with respect to the ``active`` columns. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        noise = check_noise(self.problem, noise, len(values))
        found = self.simulate(values, active=active)
        assert found.sensitivities is not None
        n, q = len(values), len(active)
        cost, log_likelihood = np.zeros(n), np.zeros(n)
        gradient, hessian = np.zeros((n, q)), np.zeros((n, q, q))
        for i, e in np.ndindex(found.outcomes.shape):
            if found.outcomes[i, e] != Outcome.OK:
                cost[i], log_likelihood[i], gradient[i], hessian[i] = np.inf, -np.inf, np.nan, np.nan
                continue
            part = self._products(e, found.outputs[e][i], found.sensitivities[e][i], noise[i, e])
            cost[i] += part[0]
            gradient[i] += part[1]
            hessian[i] += part[2]
            log_likelihood[i] += part[3]
        return GaussNewton(cost, gradient, hessian, log_likelihood, found.outcomes)

    def _products(
        self, number: int, output: FloatArray, slopes: FloatArray | None, noise: FloatArray
    ) -> tuple[float, FloatArray, FloatArray, float]:
        experiment = self.problem.experiments[number]
        assert experiment.measured is not None
        if slopes is None:
            slopes = np.zeros((*output.shape, 0))
        measured, spread, unequal = experiment.measured, experiment.spread, 0.0
        if spread is not None:
            unequal = float(np.sum(np.log(spread[np.isfinite(measured)])))
            measured, output, slopes = measured / spread, output / spread, slopes / spread[:, :, None]
        cost, gradient, hessian, found = gauss_newton_products(experiment.time, measured, output, slopes, noise)
        return cost, gradient, hessian, found - unequal
