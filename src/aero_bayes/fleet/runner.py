"""The one runner: tasks on whatever workers the user brings, rows written as they come, nothing done twice."""

from __future__ import annotations

import os
import queue
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any, Protocol, TypeVar

from aero_bayes.errors import CannotFinishError
from aero_bayes.fleet.table import Row, Table


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
    """Work on all tasks that the table does not hold yet, and write each row as it comes.

    Parameters
    ----------
    tasks : iterable of Keyed
        Read one by one, no faster than they are worked on.
    attempt : callable
        Task -> row, with the task's key under ``key``. What it raises becomes a row with ``key`` and ``error``. It must
        give the same row wherever it runs.
    table : Table
    executor : concurrent.futures.Executor, optional
        Where tasks run, one task a job; in this process by default. A task whose worker dies is tried again.
    made_of : callable
        Fingerprint of what a task is computed from; a row with another one is computed anew.
    until : callable
        No further task is begun once it says so.
    progress : callable
        Told how many tasks are done, one or more at a time.

    Raises
    ------
    CannotFinishError
        The executor takes no more tasks. What was done until then is kept.
    """

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
    ended: queue.SimpleQueue[Future[tuple[Row, Row]]] = queue.SimpleQueue()
    running: dict[Future[tuple[Row, Row]], tuple[Task, int]] = {}
    # A pool of processes breaks as a whole when one of them dies: whose fault it was shows when each is alone.
    suspects: deque[tuple[Task, int]] = deque()

    def send(task: Task, tries: int) -> None:
        try:
            future = executor.submit(_timed, attempt, task)
        except RuntimeError as error:  # broken, or shut down
            raise CannotFinishError(f"the workers are gone ({error}); run the same command again to continue") from None
        running[future] = task, tries
        future.add_done_callback(ended.put)

    def receive() -> None:
        future = ended.get()
        task, tries = running.pop(future)
        problem = future.exception() if not future.cancelled() else RuntimeError("cancelled")
        if problem is None:
            row, cost = future.result()
            table.put(row, cost | {"tries": tries}, made_of(task))
        elif tries < MAX_TRIES:
            suspects.append((task, tries + 1)) if isinstance(problem, BrokenExecutor) else send(task, tries + 1)
            return
        else:
            # If workers died, the row has no fingerprint, so that the task is tried again.
            row = failure(task.key, f"its worker died {tries} times ({type(problem).__name__})")
            table.put(row, {"tries": tries}, WORKER_DIED)
        if ended.empty():
            table.flush()
        progress(1)

    try:
        for task in wanted():
            send(task, 1)
            while len(running) >= int(getattr(executor, "window", MAX_PENDING_TASKS)):
                receive()
        while running or suspects:
            if not running:
                send(*suspects.popleft())
            receive()
    finally:
        for future in running:
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
