"""Supervision of the workers of one batch: crashes, hangs and lost replies end in an outcome of the run concerned."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.simulation.engine_library import LoadError
from aero_bayes.simulation.interface import Outcome
from aero_bayes.simulation.worker_group import INVALID_TASK, NO_TASK, WorkerGroup

TODO = 255
MAX_SILENCE = 60.0  # s after which a worker that is at no task and does not say so counts as lost
WALL_CLOCK_FACTOR = 10.0  # time limits on the wall clock after which a run that sleeps, or gets no processor, is ended
MAX_EARLY_DEATHS = 8  # workers of a batch that die before they begin a task


@dataclass(frozen=True)
class Batch:
    """Runs of one problem."""

    problem: bytes
    job: int
    outcomes: NDArray[np.uint8]
    time_limit: float


class Supervisor:
    """Watches workers until every task of a batch has an outcome.

    What workers write is not believed where it cannot be true: a model's code reaches the pipe and the shared memory,
    too."""

    def __init__(self, group: WorkerGroup, batch: Batch, give_up: Callable[[], bool]) -> None:
        self._group, self._batch, self._give_up = group, batch, give_up
        self._active: dict[int, int] = {}  # index of a worker by the descriptor of its replies
        self._silent_since: dict[int, int] = {}  # when a worker was first seen without a task, ns
        self._retried: set[int] = set()
        self._early_deaths = 0
        self._poller = select.poll()
        self._allowed = 1e9 * (1.1 * batch.time_limit + 0.05)  # ns of a run, with time for the reply

    def run(self) -> None:
        """Run the batch."""
        outcomes = self._batch.outcomes
        left = outcomes.size + 1
        try:
            # A worker that is lost may have had several runs under way. Only one of them is to blame; the others are
            # asked for again, as long as each round gets some done.
            while 0 < (todo := int(np.count_nonzero(outcomes == TODO))) < left:
                left = todo
                self._group.memory.data[self._batch.job :][:8].view(np.int64)[0] = 0  # the next task to take
                if not self._run_round():
                    break
        except BaseException:  # an interrupt must not leave a worker in the middle of a job
            self._replace_active()
            raise
        outcomes[outcomes > max(Outcome)] = Outcome.CRASHED  # TODO is one of them: tasks that were lost

    def _run_round(self) -> bool:
        """Hand out every task that has no outcome; False where the batch is given up."""
        patience = min(250.0, max(5.0, 250.0 * self._batch.time_limit))  # ms
        for index in range(min(len(self._group.workers), self._batch.outcomes.size)):
            self._begin(index, NO_TASK)
        while self._active:
            for fd, _ in self._poller.poll(patience):
                self._handle_reply(fd)
            self._end_overdue_runs()
            if self._give_up():
                self._replace_active()
                return False
        return True

    def _begin(self, index: int, first: int) -> None:
        fd = self._group.begin(index, self._batch.problem, self._batch.job, first)
        self._active[fd] = index
        self._poller.register(fd, select.POLLIN)

    def _release(self, fd: int) -> None:
        self._poller.unregister(fd)
        self._silent_since.pop(self._active.pop(fd), None)

    def _replace_active(self) -> None:
        for index in self._active.values():
            self._group.replace(index)

    def _proceed(self, index: int, task: int, end: Outcome, *, retry: bool) -> None:
        """Another worker takes over; the task that was under way ends so, or is tried once more."""
        outcomes = self._batch.outcomes
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
        task, fresh = self._group.task_of(index, self._batch.outcomes.size)
        if reply == b"d" and task == NO_TASK:
            self._release(fd)
        elif reply == b"r":  # its memory is full, or a task met an FMU that cannot be instantiated again
            self._release(fd)
            self._group.recycle(index)
            self._proceed(index, task, Outcome.MODEL_ERROR, retry=True)
        elif reply[:1] in (b"e", b"l") and fresh:
            kind = LoadError if reply[:1] == b"l" else CannotFinishError
            raise kind(reply[1:].decode(errors="replace").strip())
        else:
            self._release(fd)
            self._group.replace(index)
            self._early_deaths += fresh
            if self._early_deaths > MAX_EARLY_DEATHS:
                raise CannotFinishError("worker processes of the native engine die as soon as they start")
            self._proceed(index, task, Outcome.CRASHED, retry=True)

    def _end_overdue_runs(self) -> None:
        now = time.monotonic_ns()
        workers = self._group.workers
        clocks = {i: worker.computing_time for i in self._active.values() if (worker := workers[i])}
        for fd, index in list(self._active.items()):
            task, _ = self._group.task_of(index, self._batch.outcomes.size)
            if self._is_overdue(index, task, now, clocks[index]):
                self._release(fd)
                self._group.replace(index)
                self._proceed(index, task, Outcome.TIMED_OUT, retry=False)

    def _is_overdue(self, index: int, task: int, now: int, computed: int | None) -> bool:
        if task < 0:
            # An invalid task was written by the model's code, which runs no longer than any other.
            allowed = self._allowed if task == INVALID_TASK else max(1e9 * MAX_SILENCE, 2.0 * self._allowed)
            return now - self._silent_since.setdefault(index, now) >= allowed
        self._silent_since.pop(index, None)
        started, spent = (int(v) for v in self._group.memory.slots[index, 1:3])
        factor = WALL_CLOCK_FACTOR if computed is not None else 1.0
        # It may have begun another since the clocks were read.
        return abs(now - started) >= factor * self._allowed or abs((computed or spent) - spent) >= self._allowed
