"""The fast simulator: a compiled engine drives the FMU's own binary in worker processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import (
    FloatArray,
    GaussNewton,
    Likelihoods,
    Outcome,
    Problem,
    Trajectories,
)
from aero_bayes.simulation.spec import check_problem, write_problem
from aero_bayes.simulation.workers import TODO, WorkerPool

_TRAJECTORY, _LIKELIHOOD, _GAUSS_NEWTON = 0, 1, 2
_JOB_WORDS = 15
_BLOCK_BYTES = 32 << 20
_MOST_ROWS = 16384


@dataclass(frozen=True)
class _Block:
    """Views into the shared memory, valid until the pool's lock is released."""

    result: FloatArray
    outcomes: NDArray[np.uint8]
    outputs: list[FloatArray]
    sensitivities: list[FloatArray]


def check_values(problem: Problem, values: FloatArray) -> FloatArray:
    """Parameter vectors as a contiguous (n, p) array; InputError for another shape."""
    values = np.ascontiguousarray(values, dtype=np.float64)
    p = len(problem.targets[0])
    if values.ndim != 2 or values.shape[1] != p:
        raise InputError(f"parameter values have shape {values.shape}, expected (n, {p})")
    return values


def check_active(problem: Problem, active: Sequence[int]) -> NDArray[np.int64]:
    """Active columns as integers within range."""
    p = len(problem.targets[0])
    columns = np.asarray(active, dtype=np.int64).ravel()
    if columns.size and (columns.min() < 0 or columns.max() >= p):
        raise InputError(f"active columns {columns.tolist()} are not all within 0..{p - 1}")
    return columns


def check_noise(problem: Problem, noise: FloatArray, n: int) -> FloatArray:
    """Noise broadcast to (n, E, m, 3), m the largest number of outputs."""
    if any(experiment.measured is None for experiment in problem.experiments):
        raise InputError("a likelihood needs measurements in every experiment")
    noise = np.asarray(noise, dtype=np.float64)
    shape = (n, len(problem.experiments), max(len(e.outputs) for e in problem.experiments), 3)
    try:
        return np.broadcast_to(noise, shape)
    except ValueError as error:
        raise InputError(f"noise has shape {noise.shape}, which does not broadcast to {shape}") from error


class NativeSimulator:
    """Runs a problem with the compiled engine.

    Parameters
    ----------
    problem : Problem
    workers : int, optional
        Worker processes of its own (default: one a core); 0 runs in this process, without isolation.
    pool : WorkerPool, optional
        Workers shared with other simulators, in place of its own.

    Raises
    ------
    InputError
        Where the problem names what the model does not have.
    """

    def __init__(self, problem: Problem, workers: int | None = None, pool: WorkerPool | None = None) -> None:
        check_problem(problem)
        self.problem = problem
        self._workers = workers
        self._owns_pool = pool is None
        self.pool = WorkerPool(workers) if pool is None else pool
        self._path = self.pool.new_path()
        write_problem(problem, self.pool.binary(problem.model), self._path)
        self._closed = False

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.problem, self._workers)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

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
        columns = check_active(self.problem, active if active is not None else [])
        n, q = len(values), len(columns)
        shapes = [(e.time.size, len(e.outputs)) for e in self.problem.experiments]
        outputs = tuple(np.full((n, *shape), np.nan) for shape in shapes)
        sensitivities = tuple(np.full((n, *shape, q), np.nan) for shape in shapes)
        outcomes = np.zeros((n, len(shapes)), dtype=np.uint8)
        per_row = 8 * (1 + q) * sum(a * b for a, b in shapes)
        rows = max(1, min(_MOST_ROWS, _BLOCK_BYTES // max(1, per_row)))
        for start in range(0, n, rows):
            part = slice(start, min(n, start + rows))
            with self.pool.lock:
                block = self._run(_TRAJECTORY, values[part], columns, None)
                outcomes[part] = block.outcomes
                for e in range(len(shapes)):
                    good = block.outcomes[:, e] == Outcome.OK
                    outputs[e][part][good] = block.outputs[e][good]
                    if q:
                        sensitivities[e][part][good] = block.sensitivities[e][good]
        return Trajectories(outputs, sensitivities if active is not None else None, outcomes)

    def log_likelihood(self, values: FloatArray, noise: FloatArray) -> Likelihoods:
        """Gaussian log-likelihood of the measurements, reduced inside the engine. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        n, experiments = len(values), len(self.problem.experiments)
        noise = check_noise(self.problem, noise, n)
        result = np.full((n, experiments), -np.inf)
        outcomes = np.zeros((n, experiments), dtype=np.uint8)
        none = np.zeros(0, dtype=np.int64)
        for start in range(0, n, _MOST_ROWS):
            part = slice(start, min(n, start + _MOST_ROWS))
            with self.pool.lock:
                block = self._run(_LIKELIHOOD, values[part], none, noise[part])
                outcomes[part] = block.outcomes
                result[part] = np.where(block.outcomes == Outcome.OK, block.result[..., 0], -np.inf)
        return Likelihoods(result, outcomes)

    def gauss_newton(self, values: FloatArray, noise: FloatArray, *, active: Sequence[int]) -> GaussNewton:
        """Least-squares products with respect to the ``active`` columns. See :class:`Simulator`.

        Rows with a failed run have infinite cost, a log-likelihood of minus infinity, and NaN products.
        """
        values = check_values(self.problem, values)
        columns = check_active(self.problem, active)
        n, q, experiments = len(values), len(columns), len(self.problem.experiments)
        noise = check_noise(self.problem, noise, n)
        total = np.full((n, 2 + q + q * q), np.nan)
        outcomes = np.zeros((n, experiments), dtype=np.uint8)
        rows = max(1, min(_MOST_ROWS, _BLOCK_BYTES // (8 * experiments * (2 + q + q * q))))
        for start in range(0, n, rows):
            part = slice(start, min(n, start + rows))
            with self.pool.lock:
                block = self._run(_GAUSS_NEWTON, values[part], columns, noise[part])
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

    def _run(self, mode: int, values: FloatArray, columns: NDArray[np.int64], noise: FloatArray | None) -> _Block:
        """Lay one block out in shared memory and run it; the pool's lock is held."""
        if self._closed:
            raise InputError("the simulator is closed")
        problem = self.problem
        n, p, q, experiments = len(values), values.shape[1], len(columns), len(problem.experiments)
        varies = noise is not None and noise.strides[0] != 0
        noise_block = np.zeros(0) if noise is None else np.ascontiguousarray(noise if varies else noise[:1])
        stride = {_TRAJECTORY: 0, _LIKELIHOOD: 1, _GAUSS_NEWTON: 2 + q + q * q}[mode]
        shapes = [(e.time.size, len(e.outputs)) for e in problem.experiments] if mode == _TRAJECTORY else []
        sizes = [_JOB_WORDS, 4 * experiments, values.size, noise_block.size, q, (n * experiments + 7) // 8]
        sizes += [n * experiments * stride]
        sizes += [n * a * b for a, b in shapes] + [n * a * b * q for a, b in shapes]
        at = np.concatenate([[0], np.cumsum([(size + 7) // 8 * 8 for size in sizes])]) * 8
        arena, start = self.pool.reserve(int(at[-1]))
        at += start

        def words(index: int, size: int, kind: type[np.int64] | type[np.float64] = np.float64) -> Any:
            return arena[at[index] : at[index] + 8 * size].view(kind)

        job = words(0, _JOB_WORDS, np.int64)
        per_experiment = 0 if noise is None else noise.shape[2] * 3
        per_row = per_experiment * experiments if varies else 0
        job[:7] = 0, n * experiments, mode, experiments, p, q, per_row
        job[7:] = per_experiment, at[2], at[3], at[4], at[5], at[6], stride, at[1]
        table = words(1, 4 * experiments, np.int64).reshape(experiments, 4)
        words(2, values.size)[:] = values.ravel()
        words(3, noise_block.size)[:] = noise_block.ravel()
        words(4, q, np.int64)[:] = columns
        outcomes = arena[at[5] : at[5] + n * experiments]
        outcomes[:] = TODO
        block = _Block(
            words(6, n * experiments * stride).reshape(n, experiments, stride),
            outcomes.reshape(n, experiments),
            [words(7 + e, n * a * b).reshape(n, a, b) for e, (a, b) in enumerate(shapes)],
            [words(7 + len(shapes) + e, n * a * b * q).reshape(n, a, b, q) for e, (a, b) in enumerate(shapes)],
        )
        for e, (a, b) in enumerate(shapes):
            table[e] = at[7 + e], a * b, at[7 + len(shapes) + e], a * b * q
        self.pool.run(self._path, int(at[0]), outcomes, problem.settings.time_limit)
        return block
