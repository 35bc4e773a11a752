"""Worker processes that run other people's native code.

Values and results pass through one shared block of memory; a pipe to each worker carries a few bytes a batch. A worker
takes one task at a time from a shared counter, so a crash or a hang costs exactly the run that caused it.
"""

from __future__ import annotations

import ctypes
import os
import select
import tempfile
import threading
import time
import weakref
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.files import ScratchFolder
from aero_bayes.simulation import worker_main
from aero_bayes.simulation.interface import ClosedAtExit, Outcome
from aero_bayes.simulation.model_description import ModelDescription
from aero_bayes.simulation.worker_group import (
    INVALID_TASK,
    NO_TASK,
    LoadError,
    WorkerGroup,
    WorkerProcess,
    engine_path,
)

TODO = 255
MAX_SILENCE = 60.0  # s after which a worker that is at no task and does not say so counts as lost
WALL_CLOCK_FACTOR = 10.0  # time limits on the wall clock after which a run that sleeps, or gets no processor, is ended
MAX_EARLY_DEATHS = 8  # workers of a batch that die before they begin a task
#: Runs of a model: where its first ones all crashed or ran out of time no further one is begun.
MAX_LOST_RUNS = 24


class Supervisor:
    """Watches workers until every task of a problem's job has an outcome: crashes, hangs and lost replies end in one.

    What workers write is not believed where it cannot be true: a model's code reaches the pipe and the shared memory,
    too."""

    def __init__(
        self, group: WorkerGroup, problem: bytes, job: int, outcomes: NDArray[np.uint8], time_limit: float
    ) -> None:
        self._group, self._problem, self._job = group, problem, job
        self._outcomes, self._time_limit = outcomes, time_limit
        self._active: dict[int, int] = {}  # index of a worker by the descriptor of its replies
        self._silent_since: dict[int, int] = {}  # when a worker was first seen without a task, ns
        self._retried: set[int] = set()
        self._early_deaths = 0
        self._poller = select.poll()
        self._allowed = 1e9 * (1.1 * time_limit + 0.05)  # ns of a run, with time for the reply

    def run(self, give_up: Callable[[], bool]) -> None:
        """Run the job, or some of it until it is given up."""
        outcomes = self._outcomes
        left = outcomes.size + 1
        try:
            # A worker that is lost may have had several runs under way. Only one of them is to blame; the others are
            # asked for again, as long as each round gets some done.
            while 0 < (todo := int(np.count_nonzero(outcomes == TODO))) < left:
                left = todo
                self._group.memory[self._job :][:8].view(np.int64)[0] = 0  # the next task to take
                if not self._run_round(give_up):
                    break
        except BaseException:  # an interrupt must not leave a worker in the middle of a job
            self._replace_active()
            raise
        outcomes[outcomes > max(Outcome)] = Outcome.CRASHED  # TODO is one of them: tasks that were lost

    def _run_round(self, give_up: Callable[[], bool]) -> bool:
        """Hand out every task that has no outcome; False where the job is given up."""
        patience = min(250.0, max(5.0, 250.0 * self._time_limit))  # ms
        for index in range(min(len(self._group.workers), self._outcomes.size)):
            self._begin(index, NO_TASK)
        while self._active:
            for fd, _ in self._poller.poll(patience):
                self._handle_reply(fd)
            self._end_overdue_runs()
            if give_up():
                self._replace_active()
                return False
        return True

    def _begin(self, index: int, first: int) -> None:
        fd = self._group.begin(index, self._problem, self._job, first)
        self._active[fd] = index
        self._poller.register(fd, select.POLLIN)

    def _release(self, fd: int) -> None:
        self._poller.unregister(fd)
        self._silent_since.pop(self._active.pop(fd), None)

    def _replace_active(self) -> None:
        for index in self._active.values():
            self._group.stop(index, lost=True)

    def _proceed(self, index: int, task: int, end: Outcome, *, retry: bool) -> None:
        """Another worker takes over; the task that was under way ends so, or is tried once more."""
        outcomes = self._outcomes
        again = retry and task >= 0 and outcomes[task] == TODO and task not in self._retried
        if again:
            self._retried.add(task)
        elif task >= 0 and outcomes[task] == TODO:
            outcomes[task] = end
        if np.any(outcomes == TODO):
            self._begin(index, task if again else NO_TASK)

    def _handle_reply(self, fd: int) -> None:
        index = self._active[fd]
        reply = os.read(fd, 2048)
        task, fresh = self._group.task_of(index, self._outcomes.size)
        if reply == b"d" and task == NO_TASK:
            self._release(fd)
        elif reply == b"r":  # its memory is full, or a task met an FMU that cannot be instantiated again
            self._release(fd)
            self._group.stop(index, lost=False)
            self._proceed(index, task, Outcome.MODEL_ERROR, retry=True)
        elif reply[:1] in (b"e", b"l") and fresh:
            kind = LoadError if reply[:1] == b"l" else CannotFinishError
            raise kind(reply[1:].decode(errors="replace").strip())
        else:
            self._release(fd)
            self._group.stop(index, lost=True)
            self._early_deaths += fresh
            if self._early_deaths > MAX_EARLY_DEATHS:
                raise CannotFinishError("worker processes of the native engine die as soon as they start")
            self._proceed(index, task, Outcome.CRASHED, retry=True)

    def _end_overdue_runs(self) -> None:
        now = time.monotonic_ns()
        workers = self._group.workers
        clocks = {i: worker.computing_time for i in self._active.values() if (worker := workers[i])}
        for fd, index in list(self._active.items()):
            task, _ = self._group.task_of(index, self._outcomes.size)
            if self._is_overdue(index, task, now, clocks[index]):
                self._release(fd)
                self._group.stop(index, lost=True)
                self._proceed(index, task, Outcome.TIMED_OUT, retry=False)

    def _is_overdue(self, index: int, task: int, now: int, computed: int | None) -> bool:
        if task < 0:
            # An invalid task was written by the model's code, which runs no longer than any other.
            allowed = self._allowed if task == INVALID_TASK else max(1e9 * MAX_SILENCE, 2.0 * self._allowed)
            return now - self._silent_since.setdefault(index, now) >= allowed
        self._silent_since.pop(index, None)
        started, spent = (int(v) for v in self._group.slots[index, 1:3])
        factor = WALL_CLOCK_FACTOR if computed is not None else 1.0
        # It may have begun another since the clocks were read.
        return abs(now - started) >= factor * self._allowed or abs((computed or spent) - spent) >= self._allowed


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
        self._finalizer = weakref.finalize(self, _stop_all, self.group.workers, self._owner)

    def _new_group(self) -> WorkerGroup:
        return WorkerGroup(self.size, self.folder, self.memory_limit, self._engine_class)

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
        """Offset in the shared memory of at least `size` bytes. Hold :attr:`lock` while they are in use."""
        if os.getpid() != self._owner:  # a forked child gets workers of its own
            self._owner = os.getpid()
            self._finalizer.detach()
            self.group = self._new_group()
        return self.group.reserve(size)

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
            if before.size == MAX_LOST_RUNS and not _all_lost(before):
                return False
            first = self._first[model] = np.concatenate((before, outcomes[outcomes != TODO]))[:MAX_LOST_RUNS]
            lost = first.size == MAX_LOST_RUNS and _all_lost(first)
            if lost:
                outcomes[outcomes == TODO] = first[-1]
            return lost

        if hopeless():
            return
        Supervisor(self.group, key, job, outcomes, time_limit).run(hopeless)

    def _run_in_this_process(self, key: bytes, job: int, outcomes: NDArray[np.uint8]) -> None:
        assert self._engine is not None
        if key not in self._problems:
            error = ctypes.create_string_buffer(1024)
            problem = self._engine.ab_open(key, error, 1024)
            if not problem:
                raise CannotFinishError(error.value.decode(errors="replace"))
            self._problems[key] = problem
        problem, base = self._problems[key], self.group.memory.ctypes.data
        while ended := self._engine.ab_batch(problem, base, base + job, base, -1):
            if ended == worker_main.NOT_LOADED:
                raise LoadError(self._engine.ab_load_error(problem).decode(errors="replace"))
            outcomes[self.group.slots[0, 0]] = Outcome.MODEL_ERROR  # no other process is there to instantiate it in


def _all_lost(outcomes: NDArray[np.uint8]) -> bool:
    return set(outcomes.tolist()) <= {Outcome.TIMED_OUT, Outcome.CRASHED}


def _stop_all(workers: list[WorkerProcess | None], owner: int) -> None:
    """Stop all workers, in the process that started them."""
    if os.getpid() != owner:
        return
    for index, worker in enumerate(workers):
        if worker is not None:
            worker.stop()
            workers[index] = None
