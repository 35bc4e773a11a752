"""Batches of runs: a problem's jobs in shared memory, which the workers of a pool take tasks from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import Outcome, Problem, Trajectories
from aero_bayes.simulation.worker_group import LoadError
from aero_bayes.simulation.worker_main import JOB_WORDS
from aero_bayes.simulation.workers import TODO, WorkerPool

#: What a batch computes; the numbers of ``MODE_...`` in native/engine.h.
TRAJECTORY, LIKELIHOOD, FILTER, FILTER_LIKELIHOOD, FILTER_STATES = range(5)
BLOCK_BYTES = 32 << 20
MAX_ROWS = 16384


@dataclass(frozen=True)
class Block:
    """A job in the shared memory, kept from call to call: its parts are valid until the pool's lock is released."""

    key: tuple[int, int, int, bool, int]
    memory: NDArray[np.uint8]
    job: int
    words: NDArray[np.int64]
    header: NDArray[np.int64]
    values: FloatArray
    columns: NDArray[np.int64]
    noise: FloatArray
    result: FloatArray
    outcomes: NDArray[np.uint8]
    steps: NDArray[np.int64]
    outputs: list[FloatArray]
    sensitivities: list[FloatArray]


class Batches:
    """Batches of one problem, laid out in the shared memory of a pool whose workers run them."""

    def __init__(self, problem: Problem, pool: WorkerPool, path: Path) -> None:
        self.problem = problem
        self.pool = pool
        self.path = path
        self._block: Block | None = None

    def _shapes(self, mode: int) -> list[tuple[int, int]]:
        """Samples of each experiment, and what is given for each of them; nothing by sample in reduced modes."""
        s = len(self.problem.model.states)
        widths = {
            TRAJECTORY: lambda m: m, FILTER: lambda m: 2 * m, FILTER_STATES: lambda m: 2 * m + s + 2 * s * s + m * s,
        }  # fmt: skip
        if mode not in widths:
            return []
        return [(e.time.size, widths[mode](len(e.outputs))) for e in self.problem.experiments]

    def trajectories(
        self, values: FloatArray, active: NDArray[np.int64] | None = None, mode: int = TRAJECTORY
    ) -> Trajectories:
        """Simulate checked values; with ``active`` also sensitivities to those columns."""
        columns = np.zeros(0, dtype=np.int64) if active is None else active
        n, q = len(values), len(columns)
        shapes = self._shapes(mode)
        outputs = tuple(np.empty((n, *shape)) for shape in shapes)
        sensitivities = tuple(np.empty((n, *shape, q)) for shape in shapes)
        outcomes = np.zeros((n, len(shapes)), dtype=np.uint8)
        steps = np.zeros((n, len(shapes)), dtype=np.int64)
        for part, block in self.blocks(mode, values, columns, None, (1 + q) * sum(a * b for a, b in shapes)):
            outcomes[part], steps[part] = block.outcomes, block.steps
            for e in range(len(shapes)):
                bad = block.outcomes[:, e] != Outcome.OK
                outputs[e][part] = block.outputs[e]
                outputs[e][part][bad] = np.nan
                if q:
                    sensitivities[e][part] = block.sensitivities[e]
                    sensitivities[e][part][bad] = np.nan
        return Trajectories(outputs, sensitivities if active is not None else None, outcomes, steps)

    def blocks(
        self, mode: int, values: FloatArray, columns: NDArray[np.int64], noise: FloatArray | None, numbers: int
    ) -> Iterator[tuple[slice, Block]]:
        """Run some rows at a time, each of which gives so many numbers; a block is valid until the next one."""
        rows = max(1, min(MAX_ROWS, BLOCK_BYTES // max(1, 8 * numbers)))
        for start in range(0, len(values), rows):
            part = slice(start, min(len(values), start + rows))
            with self.pool.lock:
                yield part, self._run(mode, values[part], columns, None if noise is None else noise[part])

    def _run(self, mode: int, values: FloatArray, columns: NDArray[np.int64], noise: FloatArray | None) -> Block:
        """Lay one block out in shared memory and run it; the pool's lock is held."""
        varies = noise is not None and noise.strides[0] != 0
        noise_size = 0 if noise is None else noise[0].size * (len(noise) if varies else 1)
        key = mode, len(values), len(columns), varies, noise_size
        self.pool.reserve(0)  # after a fork the memory is another
        block = self._block
        if block is None or block.key != key or block.memory is not self.pool.group.memory:
            block = self._block = self._lay_out(key, values.shape[1])
        block.header[:] = block.words  # another simulator of the pool may have used this memory since
        block.values[:] = values
        block.columns[:] = columns
        if noise is not None:
            block.noise[:] = noise.ravel() if varies else noise[0].ravel()
        block.outcomes[:] = TODO
        outcomes = block.outcomes.reshape(-1)
        try:
            self.pool.run(self.path, block.job, outcomes, self.problem.settings.time_limit, self.problem.model.sha256)
        except LoadError as error:
            raise InputError(f"{self.problem.model.path}: its binary cannot be loaded: {error}") from None
        return block

    def _lay_out(self, key: tuple[int, int, int, bool, int], p: int) -> Block:
        mode, n, q, varies, noise_size = key
        problem = self.problem
        experiments = len(problem.experiments)
        stride = 1 if mode in (LIKELIHOOD, FILTER_LIKELIHOOD) else 0
        shapes = self._shapes(mode)
        header = len(JOB_WORDS) + 4 * experiments
        sizes = [header, n * p, noise_size, q, (n * experiments + 7) // 8, n * experiments]
        sizes += [n * experiments * stride]
        sizes += [n * a * b for a, b in shapes] + [n * a * b * q for a, b in shapes]
        at = list(accumulate(((size + 7) // 8 * 64 for size in sizes), initial=0))
        start = self.pool.reserve(at[-1])
        memory = self.pool.group.memory
        at = [start + offset for offset in at]

        def words(index: int, kind: type[np.int64] | type[np.float64] = np.float64) -> Any:
            return memory[at[index] : at[index] + 8 * sizes[index]].view(kind)

        per_row = noise_size // n if varies and n else 0
        per_experiment = (per_row if varies else noise_size) // experiments
        table = at[0] + 8 * len(JOB_WORDS)
        given = {
            "next": 0, "total": n * experiments, "mode": mode, "experiments": experiments, "p": p, "q": q,
            "noise_by_row": per_row, "noise_by_experiment": per_experiment, "values": at[1], "noise": at[2],
            "columns": at[3], "outcomes": at[4], "steps": at[5], "numbers": at[6], "stride": stride, "table": table,
        }  # fmt: skip
        job = [given[name] for name in JOB_WORDS]
        last = 7 + len(shapes)
        for e, (a, b) in enumerate(shapes):
            job += [at[7 + e], a * b, at[last + e], a * b * q]
        job += [0] * (header - len(job))
        return Block(
            key, memory, at[0], np.array(job, dtype=np.int64), words(0, np.int64), words(1).reshape(n, p),
            words(3, np.int64), words(2), words(6).reshape(n, experiments, stride),
            memory[at[4] : at[4] + n * experiments].reshape(n, experiments),
            words(5, np.int64).reshape(n, experiments),
            [words(7 + e).reshape(n, a, b) for e, (a, b) in enumerate(shapes)],
            [words(last + e).reshape(n, a, b, q) for e, (a, b) in enumerate(shapes)],
        )  # fmt: skip
