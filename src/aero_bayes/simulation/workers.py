"""Worker processes that run other people's native code.

Values and results pass through one shared block of memory; a pipe to each worker carries a few bytes a batch. A worker
takes one task at a time from a shared counter, so a crash or a hang costs exactly the run that caused it.
"""

from __future__ import annotations

import ctypes
import os
import tempfile
import threading
import weakref
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.files import ScratchFolder
from aero_bayes.simulation import worker_main
from aero_bayes.simulation.engine_library import LoadError, engine_path
from aero_bayes.simulation.interface import ClosedAtExit, Outcome
from aero_bayes.simulation.model_description import ModelDescription
from aero_bayes.simulation.supervision import TODO, Batch, Supervisor
from aero_bayes.simulation.worker_group import SharedMemory, WorkerGroup, stop_all

#: Runs of a model: where its first ones all crashed or ran out of time no further one is begun.
MAX_LOST_RUNS = 24


class WorkerPool(ClosedAtExit):
    """Worker processes shared by any number of simulators."""

    def __init__(self, workers: int | None = None, memory_limit: int = 1 << 30, *, engine: type | None = None) -> None:
        if workers is None:
            workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self.size = workers
        self.lock = threading.RLock()
        self.memory_limit = memory_limit
        self._engine_class = engine
        self._scratch = ScratchFolder()
        self.folder = self._scratch.path
        self._binaries: dict[str, Path] = {}
        self._counter = 0
        self._creator = self._owner = os.getpid()
        self._problems: dict[bytes, int] = {}
        self._first: dict[str, NDArray[np.uint8]] = {}  # how the first runs of each model ended
        self._engine = worker_main.load_engine(str(engine_path())) if workers == 0 else None
        self.group = self._new_group()
        self._finalizer = weakref.finalize(self, stop_all, self.group.workers, self._owner)

    def _new_group(self) -> WorkerGroup:
        memory = SharedMemory(max(1, self.size), self.folder)
        return WorkerGroup(self.size, self.folder, memory, self.memory_limit, self._engine_class)

    def close(self) -> None:
        """Stop the workers and remove what was unpacked."""
        for path in list(self._problems):
            self.forget(Path(os.fsdecode(path)))
        self._finalizer()
        self._scratch.close()

    @property
    def processes(self) -> tuple[int, ...]:
        """Process ids of the workers that run."""
        return tuple(worker.process.pid for worker in self.group.workers if worker is not None)

    @property
    def replaced(self) -> int:
        """How many workers crashed or were killed."""
        return self.group.replaced

    @property
    def recycled(self) -> int:
        """How many workers were ended between two runs and replaced."""
        return self.group.recycled

    @property
    def tasks(self) -> tuple[int, ...]:
        """The task that each worker is at; -1 for none."""
        return tuple(int(task) for task in self.group.memory.slots[:, 0])

    @property
    def memory(self) -> NDArray[np.uint8]:
        """The shared memory; another array after it has grown."""
        return self.group.memory.data

    def use_one_worker(self) -> None:
        """In a forked child: one worker from now on."""
        self.size = min(self.size, 1)

    def binary(self, model: ModelDescription) -> Path:
        """Return the model's binary, unpacked once into a private folder."""
        with self.lock:
            if model.sha256 not in self._binaries:
                folder = Path(tempfile.mkdtemp(prefix="fmu-", dir=self.folder))
                self._binaries[model.sha256] = model.unpack(folder)
            return self._binaries[model.sha256]

    def new_path(self) -> Path:
        """Return a name for a new problem file."""
        with self.lock:
            self._counter += 1
            return self.folder / f"problem-{os.getpid()}-{self._counter}"

    def forget(self, path: Path) -> None:
        """Free the problem at this path, which is no longer needed."""
        with self.lock:
            key = os.fsencode(path)
            if self._engine is not None and key in self._problems:
                self._engine.ab_close(self._problems.pop(key))
            if os.getpid() == self._owner:
                self.group.forget(key)
            if os.getpid() == self._creator:
                path.unlink(missing_ok=True)

    def reserve(self, size: int) -> int:
        """Offset in :attr:`memory` of at least `size` bytes. Hold :attr:`lock` while they are in use."""
        if os.getpid() != self._owner:  # a forked child gets workers of its own
            self._owner = os.getpid()
            self._finalizer.detach()
            self.group = self._new_group()
        return self.group.memory.reserve(size)

    def run(self, path: Path, job: int, outcomes: NDArray[np.uint8], time_limit: float, model: str) -> None:
        """Run the job at this offset of the shared memory until every task has an outcome.

        A model (its hash) whose first runs all crashed or ran out of time is run no more: what is left ends like them.
        """
        key = os.fsencode(path)
        if not outcomes.size:
            return
        if self._engine is not None:
            self._run_in_this_process(key, job, outcomes)
            return
        before = self._first.get(model, outcomes[:0])

        def hopeless() -> bool:
            first = self._first[model] = np.concatenate((before, outcomes[outcomes != TODO]))[:MAX_LOST_RUNS]
            lost = first.size == MAX_LOST_RUNS and bool(np.all(np.isin(first, (Outcome.TIMED_OUT, Outcome.CRASHED))))
            if lost:
                outcomes[outcomes == TODO] = first[-1]
            return lost

        if hopeless():
            return
        Supervisor(self.group, Batch(key, job, outcomes, time_limit), hopeless).run()

    def _run_in_this_process(self, key: bytes, job: int, outcomes: NDArray[np.uint8]) -> None:
        assert self._engine is not None
        if key not in self._problems:
            error = ctypes.create_string_buffer(1024)
            problem = self._engine.ab_open(key, error, 1024)
            if not problem:
                raise CannotFinishError(error.value.decode(errors="replace"))
            self._problems[key] = problem
        problem, base = self._problems[key], self.memory.ctypes.data
        while ended := self._engine.ab_batch(problem, base, base + job, base, -1):
            if ended == worker_main.NOT_LOADED:
                raise LoadError(self._engine.ab_load_error(problem).decode(errors="replace"))
            outcomes[self.tasks[0]] = Outcome.MODEL_ERROR  # no other process is there to instantiate it in
