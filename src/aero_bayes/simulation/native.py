"""The fast simulator: a compiled engine drives the FMU's own binary in worker processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.simulation.interface import (
    Filtered,
    FilteredStates,
    FloatArray,
    GaussNewton,
    Likelihoods,
    Outcome,
    Problem,
    Trajectories,
)
from aero_bayes.simulation.spec import check_problem, write_problem
from aero_bayes.simulation.workers import TODO, LoadError, WorkerPool

_TRAJECTORY, _LIKELIHOOD, _GAUSS_NEWTON = 0, 1, 2
_FILTER, _FILTER_LIKELIHOOD, _FILTER_STATES = 3, 4, 5
_JOB_WORDS = 15
_BLOCK_BYTES = 32 << 20
_MAX_ROWS = 16384


@dataclass(frozen=True)
class _Block:
    """Views into the shared memory, valid until the pool's lock is released."""

    result: FloatArray
    outcomes: NDArray[np.uint8]
    outputs: list[FloatArray]
    sensitivities: list[FloatArray]


@dataclass(frozen=True)
class _Layout:
    """Where the parts of a job lie in the shared memory, kept from call to call."""

    key: tuple[int, int, int, bool, int]
    arena: NDArray[np.uint8]
    job: int
    words: NDArray[np.int64]
    header: NDArray[np.int64]
    values: FloatArray
    columns: NDArray[np.int64]
    noise: FloatArray
    block: _Block


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


class Batches:
    """Batches of one problem, laid out in the shared memory of a pool whose workers run them.

    Parameters
    ----------
    problem : Problem
    pool : WorkerPool
    path : Path
        Where the problem is written for the workers.
    """

    def __init__(self, problem: Problem, pool: WorkerPool, path: Path) -> None:
        self.problem = problem
        self.pool = pool
        self.path = path
        self._layout: _Layout | None = None

    def _shapes(self, mode: int) -> list[tuple[int, int]]:
        """Samples of each experiment, and what is given for each of them; nothing by sample in reduced modes."""
        s = len(self.problem.model.states)
        widths = {
            _TRAJECTORY: lambda m: m, _FILTER: lambda m: 2 * m, _FILTER_STATES: lambda m: 2 * m + s + 2 * s * s + m * s,
        }  # fmt: skip
        if mode not in widths:
            return []
        return [(e.time.size, widths[mode](len(e.outputs))) for e in self.problem.experiments]

    def trajectories(
        self, values: FloatArray, active: NDArray[np.int64] | None = None, mode: int = _TRAJECTORY
    ) -> Trajectories:
        """Of checked values; with ``active`` also sensitivities to those columns."""
        columns = np.zeros(0, dtype=np.int64) if active is None else active
        n, q = len(values), len(columns)
        shapes = self._shapes(mode)
        outputs = tuple(np.empty((n, *shape)) for shape in shapes)
        sensitivities = tuple(np.empty((n, *shape, q)) for shape in shapes)
        outcomes = np.zeros((n, len(shapes)), dtype=np.uint8)
        per_row = 8 * (1 + q) * sum(a * b for a, b in shapes)
        rows = max(1, min(_MAX_ROWS, _BLOCK_BYTES // max(1, per_row)))
        for start in range(0, n, rows):
            part = slice(start, min(n, start + rows))
            with self.pool.lock:
                block = self.run(mode, values[part], columns, None)
                outcomes[part] = block.outcomes
                for e in range(len(shapes)):
                    bad = block.outcomes[:, e] != Outcome.OK
                    outputs[e][part] = block.outputs[e]
                    outputs[e][part][bad] = np.nan
                    if q:
                        sensitivities[e][part] = block.sensitivities[e]
                        sensitivities[e][part][bad] = np.nan
        return Trajectories(outputs, sensitivities if active is not None else None, outcomes)

    def run(self, mode: int, values: FloatArray, columns: NDArray[np.int64], noise: FloatArray | None) -> _Block:
        """Lay one block out in shared memory and run it; the pool's lock is held."""
        varies = noise is not None and noise.strides[0] != 0
        noise_size = 0 if noise is None else noise[0].size * (len(noise) if varies else 1)
        key = mode, len(values), len(columns), varies, noise_size
        self.pool.reserve(0)  # after a fork the memory is another
        layout = self._layout
        if layout is None or layout.key != key or layout.arena is not self.pool.arena:
            layout = self._layout = self._lay_out(key, values.shape[1])
        layout.header[:] = layout.words  # another simulator of the pool may have used this memory since
        layout.values[:] = values
        layout.columns[:] = columns
        if noise is not None:
            layout.noise[:] = noise.ravel() if varies else noise[0].ravel()
        layout.block.outcomes[:] = TODO
        outcomes = layout.block.outcomes.reshape(-1)
        try:
            self.pool.run(self.path, layout.job, outcomes, self.problem.settings.time_limit, self.problem.model.sha256)
        except LoadError as error:
            raise InputError(f"{self.problem.model.path}: its binary cannot be loaded: {error}") from None
        return layout.block

    def _lay_out(self, key: tuple[int, int, int, bool, int], p: int) -> _Layout:
        mode, n, q, varies, noise_size = key
        problem = self.problem
        experiments = len(problem.experiments)
        stride = {_LIKELIHOOD: 1, _FILTER_LIKELIHOOD: 1, _GAUSS_NEWTON: 2 + q + q * q}.get(mode, 0)
        shapes = self._shapes(mode)
        header = _JOB_WORDS + 4 * experiments
        sizes = [header, n * p, noise_size, q, (n * experiments + 7) // 8, n * experiments * stride]
        sizes += [n * a * b for a, b in shapes] + [n * a * b * q for a, b in shapes]
        at = list(accumulate(((size + 7) // 8 * 64 for size in sizes), initial=0))
        arena, start = self.pool.reserve(at[-1])
        at = [start + offset for offset in at]

        def words(index: int, kind: type[np.int64] | type[np.float64] = np.float64) -> Any:
            return arena[at[index] : at[index] + 8 * sizes[index]].view(kind)

        per_row = noise_size // n if varies and n else 0
        per_experiment = (per_row if varies else noise_size) // experiments
        table = at[0] + 8 * _JOB_WORDS
        job = [0, n * experiments, mode, experiments, p, q, per_row, per_experiment]
        job += [at[1], at[2], at[3], at[4], at[5], stride, table]
        last = 6 + len(shapes)
        for e, (a, b) in enumerate(shapes):
            job += [at[6 + e], a * b, at[last + e], a * b * q]
        job += [0] * (header - len(job))
        block = _Block(
            words(5).reshape(n, experiments, stride),
            arena[at[4] : at[4] + n * experiments].reshape(n, experiments),
            [words(6 + e).reshape(n, a, b) for e, (a, b) in enumerate(shapes)],
            [words(last + e).reshape(n, a, b, q) for e, (a, b) in enumerate(shapes)],
        )
        job_words = np.array(job, dtype=np.int64)
        return _Layout(
            key,
            arena,
            at[0],
            job_words,
            words(0, np.int64),
            words(1).reshape(n, p),
            words(3, np.int64),
            words(2),
            block,
        )


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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

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
        mode = _LIKELIHOOD if self.problem.process is None else _FILTER_LIKELIHOOD
        for start in range(0, n, _MAX_ROWS):
            part = slice(start, min(n, start + _MAX_ROWS))
            with self.pool.lock:
                block = batches.run(mode, values[part], none, noise[part])
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
        batches = self._open_batches()
        total = np.full((n, 2 + q + q * q), np.nan)
        outcomes = np.zeros((n, experiments), dtype=np.uint8)
        rows = max(1, min(_MAX_ROWS, _BLOCK_BYTES // (8 * experiments * (2 + q + q * q))))
        for start in range(0, n, rows):
            part = slice(start, min(n, start + rows))
            with self.pool.lock:
                block = batches.run(_GAUSS_NEWTON, values[part], columns, noise[part])
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
        found = self._open_batches().trajectories(values, columns, _FILTER)
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
        """The filter's states at one parameter vector. See :class:`Filter`."""
        values = self._check_filter(np.asarray(values)[np.newaxis])
        found = self._open_batches().trajectories(values, None, _FILTER_STATES)
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
    """The numbers (n, ...) that the engine gives for each sample, by what they are."""
    n = len(rows)
    predicted, variance, mean, covariance, transition, slopes = np.split(
        rows, list(accumulate((m, m, s, s * s, s * s))), axis=1
    )
    return FilteredStates(
        mean, covariance.reshape(n, s, s), transition.reshape(n, s, s), slopes.reshape(n, m, s), predicted, variance
    )
