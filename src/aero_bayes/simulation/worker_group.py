"""The worker processes of a pool, each started when it is first needed and replaced when it is lost."""

from __future__ import annotations

import os
from pathlib import Path

from aero_bayes.simulation import worker_main
from aero_bayes.simulation.shared_memory import SLOT_BYTES, SharedMemory
from aero_bayes.simulation.worker_process import WorkerProcess

NO_TASK = -1
INVALID_TASK = -2


class WorkerGroup:
    """As many workers as the shared memory has slots."""

    def __init__(
        self, size: int, folder: Path, memory: SharedMemory, memory_limit: int, engine: type | None = None
    ) -> None:
        self.workers: list[WorkerProcess | None] = [None] * size
        self.memory = memory
        self.replaced = self.recycled = 0
        self._folder, self._memory_limit, self._engine = folder, memory_limit, engine

    def begin(self, index: int, problem: bytes, job: int, first: int) -> int:
        """Let a worker take tasks of a job, `first` before all others; gives the file descriptor of its replies."""
        worker = self.workers[index]
        if worker is None:
            worker = WorkerProcess.start(self._folder, self.memory.fd, self._memory_limit, self._engine)
            self.workers[index] = worker
        self.memory.slots[index, :3] = NO_TASK, 0, 0
        worker.send(worker_main.RUN, self.memory.data.size, job, index * SLOT_BYTES, first, problem)
        return worker.replies

    def forget(self, problem: bytes) -> None:
        """Free a problem that is no longer needed."""
        for worker in self.workers:
            if worker is not None:
                worker.send(worker_main.FORGET, 0, 0, 0, 0, problem)

    def task_of(self, index: int, count: int) -> tuple[int, bool]:
        """Return the task that a worker is at, NO_TASK, or INVALID_TASK beyond `count`.

        And whether it never had any."""
        task, started = (int(v) for v in self.memory.slots[index, :2])
        return (task if NO_TASK <= task < count else INVALID_TASK), (task, started) == (NO_TASK, 0)

    def replace(self, index: int) -> None:
        """Stop a worker that is lost; the next that is asked of it starts another."""
        self._stop(index)
        self.replaced += 1

    def recycle(self, index: int) -> None:
        """Stop a worker whose memory is full, or whose FMU cannot be instantiated again."""
        self._stop(index)
        self.recycled += 1

    def _stop(self, index: int) -> None:
        worker = self.workers[index]
        self.workers[index] = None
        if worker is not None:
            worker.stop()


def stop_all(workers: list[WorkerProcess | None], owner: int) -> None:
    """Stop all workers, in the process that started them."""
    if os.getpid() != owner:
        return
    for index, worker in enumerate(workers):
        if worker is not None:
            worker.stop()
            workers[index] = None
