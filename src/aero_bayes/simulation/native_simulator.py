"""The fast simulator: a compiled engine drives the FMU's own binary in worker processes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.closing import ClosedAtExit
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.simulation.batches import (
    BLOCK_BYTES,
    FILTER,
    FILTER_LIKELIHOOD,
    FILTER_STATES,
    GAUSS_NEWTON,
    LIKELIHOOD,
    MAX_ROWS,
    Batches,
)
from aero_bayes.simulation.interface import (
    Filtered,
    FilteredStates,
    GaussNewton,
    Likelihoods,
    Outcome,
    Problem,
    Trajectories,
)
from aero_bayes.simulation.problem_checks import check_active, check_noise, check_problem, check_values
from aero_bayes.simulation.problem_file import write_problem
from aero_bayes.simulation.workers import WorkerPool


class NativeSimulator(ClosedAtExit):
    """Runs a problem with the compiled engine."""

    engine = "native"

    def __init__(self, problem: Problem, workers: int | None = None, pool: WorkerPool | None = None) -> None:
        if problem.model.interface != "model exchange":
            raise InputError(f"{problem.model.path}: has no Model Exchange, which the native engine needs")
        check_problem(problem)
        self.problem = problem
        self._workers = workers
        self._owns_pool = pool is None
        self.pool = WorkerPool(workers) if pool is None else pool
        self._path = self.pool.new_path()
        write_problem(problem, self.pool.binary(problem.model), self._path)
        self._batches = Batches(problem, self.pool, self._path)
        self._closed = False

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.problem, self._workers)

    def _open_batches(self) -> Batches:
        if self._closed:
            raise InputError("the simulator is closed")
        return self._batches

    def close(self) -> None:
        """Stop the workers (own ones) and free the model."""
        if self._closed:
            return
        self._closed = True
        self.pool.forget(self._path)
        if self._owns_pool:
            self.pool.close()

    def simulate(self, values: FloatArray, *, active: Sequence[int] | None = None) -> Trajectories:
        """Trajectories; with ``active`` also sensitivities to those columns. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        return self._open_batches().trajectories(values, None if active is None else check_active(self.problem, active))

    def log_likelihood(self, values: FloatArray, noise: FloatArray) -> Likelihoods:
        """Gaussian log-likelihood of the measurements, reduced inside the engine. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        n, experiments = len(values), len(self.problem.experiments)
        noise = check_noise(self.problem, noise, n)
        batches = self._open_batches()
        result = np.full((n, experiments), -np.inf)
        outcomes = np.zeros((n, experiments), dtype=np.uint8)
        none = np.zeros(0, dtype=np.int64)
        mode = LIKELIHOOD if self.problem.process is None else FILTER_LIKELIHOOD
        for start in range(0, n, MAX_ROWS):
            part = slice(start, min(n, start + MAX_ROWS))
            with self.pool.lock:
                block = batches.run(mode, values[part], none, noise[part])
                outcomes[part] = block.outcomes
                result[part] = np.where(block.outcomes == Outcome.OK, block.result[..., 0], -np.inf)
        return Likelihoods(result, outcomes)

    def gauss_newton(self, values: FloatArray, noise: FloatArray, *, active: Sequence[int]) -> GaussNewton:
        """Least-squares products with respect to the ``active`` columns. See :class:`Simulator`.

        Rows with a failed run have infinite cost, a log-likelihood of minus infinity, and NaN products."""
        values = check_values(self.problem, values)
        columns = check_active(self.problem, active)
        n, q, experiments = len(values), len(columns), len(self.problem.experiments)
        noise = check_noise(self.problem, noise, n)
        batches = self._open_batches()
        total = np.full((n, 2 + q + q * q), np.nan)
        outcomes = np.zeros((n, experiments), dtype=np.uint8)
        rows = max(1, min(MAX_ROWS, BLOCK_BYTES // (8 * experiments * (2 + q + q * q))))
        for start in range(0, n, rows):
            part = slice(start, min(n, start + rows))
            with self.pool.lock:
                block = batches.run(GAUSS_NEWTON, values[part], columns, noise[part])
                outcomes[part] = block.outcomes
                good = np.all(block.outcomes == Outcome.OK, axis=1)
                total[part][good] = block.result[good].sum(axis=1)
        bad = np.any(outcomes != Outcome.OK, axis=1)
        return GaussNewton(
            cost=np.where(bad, np.inf, total[:, 0]),
            gradient=total[:, 2 : 2 + q].copy(),
            hessian=total[:, 2 + q :].reshape(n, q, q).copy(),
            log_likelihood=np.where(bad, -np.inf, total[:, 1]),
            outcomes=outcomes,
        )

    def filter(self, values: FloatArray, *, active: Sequence[int] = ()) -> Filtered:
        """Predictions of the readings by an extended Kalman filter. See :class:`Filter`."""
        values, columns = self._check_filter(values), check_active(self.problem, active)
        found = self._open_batches().trajectories(values, columns, FILTER)
        assert found.sensitivities is not None
        halves = [len(e.outputs) for e in self.problem.experiments]
        y, slopes = found.outputs, found.sensitivities
        return Filtered(
            tuple(a[..., :m] for a, m in zip(y, halves, strict=True)),
            tuple(a[..., m:] for a, m in zip(y, halves, strict=True)),
            tuple(a[:, :, :m] for a, m in zip(slopes, halves, strict=True)),
            tuple(a[:, :, m:] for a, m in zip(slopes, halves, strict=True)),
            found.outcomes,
        )

    def filtered_states(self, values: FloatArray) -> tuple[FilteredStates, ...]:
        """Return the filter's states at one parameter vector. See :class:`Filter`."""
        values = self._check_filter(np.asarray(values)[np.newaxis])
        found = self._open_batches().trajectories(values, None, FILTER_STATES)
        for outcome in found.outcomes[0]:
            if outcome != Outcome.OK:
                raise CannotFinishError(f"the filter of process noise failed: {Outcome(outcome).text}")
        s = len(self.problem.model.states)
        return tuple(
            _filtered_states(rows[0], len(e.outputs), s)
            for rows, e in zip(found.outputs, self.problem.experiments, strict=True)
        )

    def _check_filter(self, values: FloatArray) -> FloatArray:
        if self.problem.process is None:
            raise InputError("the problem has no process noise to filter")
        return check_values(self.problem, values)


def _filtered_states(rows: FloatArray, m: int, s: int) -> FilteredStates:
    """Return the numbers (n, ...) that the engine gives for each sample, by what they are."""
    n = len(rows)
    predicted, variance, mean, covariance, transition, slopes = np.split(
        rows, list(accumulate((m, m, s, s * s, s * s))), axis=1
    )
    return FilteredStates(
        mean, covariance.reshape(n, s, s), transition.reshape(n, s, s), slopes.reshape(n, m, s), predicted, variance
    )
