"""Likelihoods and Gauss-Newton products from whole trajectories, for simulators that cannot reduce inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.closing import ClosedAtExit
from aero_bayes.simulation.gaussian import gauss_newton_products
from aero_bayes.simulation.interface import (
    DelayTarget,
    GaussNewton,
    Likelihoods,
    Outcome,
    Problem,
    SolverSettings,
    Trajectories,
)
from aero_bayes.simulation.problem_checks import check_active, check_noise, check_values, target_scale

#: Step of a central difference relative to the value; runs of a solver are computed at tolerances this much tighter.
RELATIVE_STEP, TIGHTER, TIGHTEST = 1e-4, 1e-3, 1e-12
#: What a step in a delay is relative to, in s.
DELAY_SIZE = 0.1


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


class SingleRuns(ReducedTrajectories, ClosedAtExit):
    """A :class:`Simulator` that does one run after the other, in this process; slopes are central differences."""

    def _run(self, number: int, values: FloatArray, settings: SolverSettings) -> tuple[FloatArray, Outcome]:
        """Simulate one experiment at one parameter vector (p,): outputs (n, m), NaN where the run fails."""
        raise NotImplementedError

    def simulate(self, values: FloatArray, *, active: Sequence[int] | None = None) -> Trajectories:
        """Compute trajectories; with ``active`` also sensitivities to those columns. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        columns = check_active(self.problem, active if active is not None else [])
        experiments = self.problem.experiments
        outcomes = np.zeros((len(values), len(experiments)), dtype=np.uint8)
        outputs = tuple(np.empty((len(values), e.time.size, len(e.outputs))) for e in experiments)
        slopes = tuple(np.full((*out.shape, len(columns)), np.nan) for out in outputs)
        for i, e in np.ndindex(outcomes.shape):
            outputs[e][i], outcomes[i, e] = self._run(e, values[i], self.problem.settings)
            if outcomes[i, e] == Outcome.OK:
                for place, column in enumerate(columns.tolist()):
                    slopes[e][i, ..., place] = self._slope(e, values[i], column)
        return Trajectories(outputs, slopes if active is not None else None, outcomes)

    def _slope(self, number: int, values: FloatArray, column: int) -> FloatArray:
        problem = self.problem
        experiment, target = problem.experiments[number], problem.targets[number][column]
        if target is None:
            return np.zeros((experiment.time.size, len(experiment.outputs)))
        settings = replace(
            problem.settings,
            relative_tolerance=max(TIGHTEST, TIGHTER * problem.settings.relative_tolerance),
            absolute_tolerance=max(TIGHTEST, TIGHTER * problem.settings.absolute_tolerance),
        )
        size = abs(values[column]) or target_scale(problem.model, experiment, target)
        step = RELATIVE_STEP * (DELAY_SIZE if isinstance(target, DelayTarget) else size)
        sides = []
        for sign in (1.0, -1.0):
            trial = values.copy()
            trial[column] += sign * step
            sides.append(self._run(number, trial, settings)[0])
        return np.asarray((sides[0] - sides[1]) / (2.0 * step))

    def close(self) -> None:
        """Free what the simulator holds."""
