"""The one runner: tasks on whatever workers the user brings, rows written as they come, nothing done twice."""

from __future__ import annotations

import os
import queue
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any, Generic, Protocol, TypeVar

from aero_bayes.errors import CannotFinishError
from aero_bayes.fleets.table import Row, Table


class Keyed(Protocol):
    """A task with a unique key."""

    @property
    def key(self) -> str: ...


Task = TypeVar("Task", bound=Keyed)
Progress = Callable[[int], None]
#: Tasks that wait or run at a time where the executor does not say; enough for thousands of workers, and what bounds
#: the memory of the caller.
MAX_PENDING_TASKS = 4096
#: How often a task is given to a worker before it counts as what killed them.
MAX_TRIES = 3
#: Fingerprint of a row that says that its workers died.
WORKER_DIED = "worker died"


def run_tasks(
    tasks: Iterable[Task],
    attempt: Callable[[Task], Row],
    table: Table,
    executor: Executor | None = None,
    *,
    made_of: Callable[[Task], str] = lambda task: "",
    until: Callable[[], bool] = lambda: False,
    progress: Progress = lambda count: None,
) -> None:
    """Work on all tasks that the table does not hold yet, and write each row as it comes."""

    def wanted() -> Iterator[Task]:
        for task in tasks:
            if table.has(task.key, made_of(task)):
                progress(1)
            elif until():
                return
            else:
                yield task

    if executor is None:
        for task in wanted():
            table.put(*_timed(attempt, task), made_of(task))
            table.flush()
            progress(1)
        return
    running = _Running(executor, attempt, table, made_of, progress)
    try:
        for task in wanted():
            running.send(task)
            while running.full:
                running.receive()
        while running.left:
            running.receive()
    finally:
        running.cancel()


class _Running(Generic[Task]):
    """Tasks on their way, each with how often it was sent; rows are written as they come back."""

    def __init__(
        self,
        executor: Executor,
        attempt: Callable[[Task], Row],
        table: Table,
        made_of: Callable[[Task], str],
        progress: Progress,
    ) -> None:
        self._executor, self._attempt, self._table = executor, attempt, table
        self._made_of, self._progress = made_of, progress
        self._ended: queue.SimpleQueue[Future[tuple[Row, Row]]] = queue.SimpleQueue()
        self._sent: dict[Future[tuple[Row, Row]], tuple[Task, int]] = {}
        # A pool of processes breaks as a whole when one of them dies: whose fault it was shows when each is alone.
        self._suspects: deque[tuple[Task, int]] = deque()

    @property
    def full(self) -> bool:
        """Whether no further task is to be sent before one has ended."""
        return len(self._sent) >= int(getattr(self._executor, "window", MAX_PENDING_TASKS))

    @property
    def left(self) -> bool:
        """Whether a task has not ended yet; a suspect is sent where nothing else runs."""
        if not self._sent and self._suspects:
            self.send(*self._suspects.popleft())
        return bool(self._sent)

    def send(self, task: Task, tries: int = 1) -> None:
        """Give a task to the executor."""
        try:
            future = self._executor.submit(_timed, self._attempt, task)
        except RuntimeError as error:  # broken, or shut down
            raise CannotFinishError(f"the workers are gone ({error}); run the same command again to continue") from None
        self._sent[future] = task, tries
        future.add_done_callback(self._ended.put)

    def receive(self) -> None:
        """Wait for the next task that ends; write its row, or try it again if its worker died."""
        future = self._ended.get()
        task, tries = self._sent.pop(future)
        problem = future.exception() if not future.cancelled() else RuntimeError("cancelled")
        if problem is not None and tries < MAX_TRIES:
            again = task, tries + 1
            self._suspects.append(again) if isinstance(problem, BrokenExecutor) else self.send(*again)
            return
        if problem is None:
            row, cost = future.result()
            self._table.put(row, cost | {"tries": tries}, self._made_of(task))
        else:
            # If workers died, the row has no fingerprint, so that the task is tried again.
            row = failure(task.key, f"its worker died {tries} times ({type(problem).__name__})")
            self._table.put(row, {"tries": tries}, WORKER_DIED)
        if self._ended.empty():
            self._table.flush()
        self._progress(1)

    def cancel(self) -> None:
        """Cancel what has not begun."""
        for future in self._sent:
            future.cancel()


def _timed(attempt: Callable[[Task], Row], task: Task) -> tuple[Row, dict[str, Any]]:
    """Make a row, and say what it took; runs on the worker. Only a worker's death ends without a row."""
    began, cpu = time.perf_counter(), sum(os.times()[:4])  # of this process and its children that have ended
    try:
        row = attempt(task)
    except Exception as error:
        row = failure(task.key, f"{type(error).__name__}: {error}")
    cost = {"seconds": time.perf_counter() - began, "cpu_seconds": sum(os.times()[:4]) - cpu}
    return row, cost | {"worker": f"{socket.gethostname()}/{os.getpid()}"}


def failure(key: str, reason: str) -> Row:
    """Make the row of a task that gave none."""
    return {"key": key, "error": " ".join(reason.split())}
