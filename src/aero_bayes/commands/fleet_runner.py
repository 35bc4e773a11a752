"""The one runner: tasks on any executor, rows written to one SQLite file as they come, nothing done twice."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import queue
import signal
import socket
import sqlite3
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from logging import ERROR
from pathlib import Path
from typing import Any, ParamSpec, Protocol, Self, TypeVar

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.simulation.worker_main import watch_parent

P = ParamSpec("P")
T = TypeVar("T")
#: Tasks after which a process of this machine is replaced, so that what leaks cannot grow.
TASKS_PER_PROCESS = 50
#: How long a scheduler is looked for, in s.
CONNECT_TIMEOUT = 20.0
#: One core is what one task gets: BLAS threads would fight the other tasks.
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class LocalPool(ThreadPoolExecutor):
    """Threads of which each has a process of its own: one that dies takes no other task with it."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._own = threading.local()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run a function in the next process that is free."""
        return super().submit(self._in_process, partial(fn, *args, **kwargs))

    def _in_process(self, work: Callable[[], T]) -> T:
        process = getattr(self._own, "process", None)
        if process is None:
            context = multiprocessing.get_context("spawn")
            process = ProcessPoolExecutor(1, context, _begin, (os.getpid(),), max_tasks_per_child=TASKS_PER_PROCESS)
            self._own.process = process
        try:
            return process.submit(work).result()
        except BrokenProcessPool:
            self._own.process = None
            raise


def _begin(parent: int) -> None:
    """Have a new process of the pool end when the parent does, however that ends."""
    # What Ctrl-C sends reaches every process; only the parent has something to say about it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=watch_parent, args=(parent,), daemon=True).start()


@contextmanager
def open_executor(dask: str | None = None, workers: int | None = None) -> Iterator[Executor]:
    """Open this machine's cores, or the workers of a running Dask scheduler."""
    count = workers or len(os.sched_getaffinity(0))
    if dask is None:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        with LocalPool(count) as pool:
            try:
                yield pool
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                for process in multiprocessing.active_children():  # in the middle of their tasks
                    process.terminate()
                raise
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask needs dask.distributed: pip install 'aero-bayes[fleet]'") from None
    where: dict[str, Any] = {"scheduler_file": dask} if dask.endswith(".json") else {"address": dask}
    if dask == "local":
        where = {"n_workers": count, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": ERROR}
    try:
        client = Client(**where, timeout=CONNECT_TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"{dask}: no Dask scheduler answers there ({type(error).__name__})") from None
    with client:
        yield client.get_executor()  # type: ignore[no-untyped-call]


Row = dict[str, Any]
Progress = Callable[[int], None]
#: Tasks that wait or run at a time; enough for thousands of workers, and what bounds the memory of the caller.
MAX_PENDING_TASKS = 4096
#: How often a task is given to a worker before it counts as what killed them.
MAX_TRIES = 3
#: Fingerprint of a row that says that its workers died: the task is tried again at the next start.
WORKER_DIED = "worker died"


class KeyedTask(Protocol):
    """A task with a unique key, and a fingerprint of all that its row is made of."""

    @property
    def key(self) -> str: ...

    @property
    def made_of(self) -> str: ...


Task = TypeVar("Task", bound=KeyedTask)


class Table:
    """Rows by key, in the order of their keys whatever the order in which they came.

    ``row`` holds what is the same however often and wherever it is computed; ``cost`` what it took, and where."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._database = sqlite3.connect(path, isolation_level=None, timeout=60.0)
        try:
            # No write-ahead log: it does not work on network file systems, where clusters keep their results.
            self._database.execute("PRAGMA journal_mode = TRUNCATE")
            self._database.execute(
                "CREATE TABLE IF NOT EXISTS rows (key TEXT PRIMARY KEY, made_of TEXT, row TEXT, cost TEXT)"
            )
        except sqlite3.DatabaseError as error:
            self._database.close()
            if isinstance(error, sqlite3.OperationalError):  # the disk, not the file
                raise
            raise InputError(f"{path}: not a table of rows ({error})") from None

    def has(self, key: str, made_of: str) -> bool:
        """Tell whether the row is there and was made of just this."""
        found = self._database.execute("SELECT 1 FROM rows WHERE key = ? AND made_of = ?", (key, made_of))
        return found.fetchone() is not None

    def put(self, row: Row, cost: Mapping[str, Any], made_of: str) -> None:
        """Write a row, which carries its key under ``key``, to the disk."""
        texts = (json.dumps(row, sort_keys=True), json.dumps(cost, sort_keys=True))
        self._database.execute("REPLACE INTO rows VALUES (?, ?, ?, ?)", (row["key"], made_of, *texts))

    def rows(self) -> Iterator[tuple[Row, Row]]:
        """Read all rows with their costs, one at a time."""
        for row, cost in self._database.execute("SELECT row, cost FROM rows ORDER BY key"):
            yield json.loads(row), json.loads(cost)

    def keep_only(self, keys: set[str]) -> None:
        """Drop rows of other keys."""
        present = {key for (key,) in self._database.execute("SELECT key FROM rows")}
        self._database.executemany("DELETE FROM rows WHERE key = ?", [(key,) for key in present - keys])

    def digest(self) -> str:
        """Hash all rows, costs left out: equal for equal tables."""
        total = hashlib.sha256()
        for (text,) in self._database.execute("SELECT row FROM rows ORDER BY key"):
            total.update(f"{text}\n".encode())
        return total.hexdigest()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._database.close()


def run_tasks(
    tasks: Iterable[Task],
    attempt: Callable[[Task], Row],
    table: Table,
    executor: Executor,
    progress: Progress = lambda count: None,
) -> None:
    """Work on all tasks that the table does not hold yet, and write each row as it comes."""
    ended: queue.SimpleQueue[Future[tuple[Row, Row]]] = queue.SimpleQueue()
    sent: dict[Future[tuple[Row, Row]], tuple[Task, str, int]] = {}

    def send(task: Task, made_of: str, tries: int = 1) -> None:
        try:
            future = executor.submit(_timed, attempt, task)
        except RuntimeError as error:  # broken, or shut down
            raise CannotFinishError(f"the workers are gone ({error}); run the same command again to continue") from None
        sent[future] = task, made_of, tries
        future.add_done_callback(ended.put)

    def receive() -> None:
        future = ended.get()
        task, made_of, tries = sent.pop(future)
        problem = CancelledError() if future.cancelled() else future.exception()
        if problem is None:
            row, cost = future.result()
            table.put(row, cost | {"tries": tries}, made_of)
        elif tries < MAX_TRIES:
            send(task, made_of, tries + 1)
            return
        else:
            row = failure(task.key, f"its worker died {tries} times ({type(problem).__name__})")
            table.put(row, {"tries": tries}, WORKER_DIED)
        progress(1)

    try:
        for task in tasks:
            made_of = task.made_of
            if table.has(task.key, made_of):
                progress(1)
                continue
            send(task, made_of)
            # What is done is written at once: a caller that is killed while it sends loses nothing that was finished.
            while len(sent) >= MAX_PENDING_TASKS or not ended.empty():
                receive()
        while sent:
            receive()
    finally:
        for future in sent:
            future.cancel()


def _timed(attempt: Callable[[Task], Row], task: Task) -> tuple[Row, Row]:
    """Make a row, and say what it took; runs on the worker. Only a worker's death ends without a row."""
    began = time.perf_counter()
    try:
        row = attempt(task)
    except Exception as error:
        row = failure(task.key, f"{type(error).__name__}: {error}")
    return row, {"seconds": time.perf_counter() - began, "worker": f"{socket.gethostname()}/{os.getpid()}"}


def failure(key: str, reason: str) -> Row:
    """Make the row of a task that gave none."""
    return {"key": key, "error": " ".join(reason.split())}
