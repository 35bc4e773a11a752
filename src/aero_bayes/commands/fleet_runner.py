"""The runner of fleets: tasks here or by Dask, rows written to one SQLite file as they come, nothing done twice."""

from __future__ import annotations

import hashlib
import json
import os
import socket
import sqlite3
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from logging import ERROR
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.parallel import Lost, results

T = TypeVar("T")
R = TypeVar("R")
#: How long a scheduler is looked for, in s.
CONNECT_TIMEOUT = 20.0
#: One core is what one task gets: BLAS threads would fight the other tasks.
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def open_client(address: str | None, workers: int | None = None) -> Iterator[Any]:
    """Open the workers of a Dask scheduler: at an address, by its file, or a ``local`` cluster of this machine.

    None gives None."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask needs dask.distributed: pip install 'aero-bayes[fleet]'") from None
    where: dict[str, Any] = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
    if address == "local":
        count = workers or len(os.sched_getaffinity(0))
        where = {"n_workers": count, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": ERROR}
    try:
        client = Client(**where, timeout=CONNECT_TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"{address}: no Dask scheduler answers there ({type(error).__name__})") from None
    with client:
        yield client


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
    *,
    client: Any = None,
    workers: int | None = None,
    progress: Progress = lambda count: None,
) -> None:
    """Work on all tasks that the table does not hold yet, and write each row as it comes.

    Processes of this machine do it, by default one for each core; or the workers of a Dask client."""

    def wanted() -> Iterator[tuple[Task, str]]:
        for task in tasks:
            made_of = task.made_of
            if table.has(task.key, made_of):
                progress(1)
            else:
                yield task, made_of

    work = partial(_timed, attempt)
    if client is None:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        answers = results(work, wanted(), workers or len(os.sched_getaffinity(0)), tries=MAX_TRIES)
    else:
        answers = _by_dask(work, wanted(), client)
    with closing(answers):
        for (task, made_of), answer in answers:
            if isinstance(answer, Lost):
                row = failure(task.key, f"its worker died {answer.tries} times")
                table.put(row, {}, WORKER_DIED)
            else:
                table.put(*answer, made_of)
            progress(1)


def _by_dask(work: Callable[[T], R], items: Iterator[T], client: Any) -> Generator[tuple[T, R | Lost]]:
    """Yield each item with what the workers of a client make of it. Dask gives the item of a dead worker to another."""
    from distributed import as_completed

    sent: dict[Any, T] = {}
    ended = as_completed(loop=client.loop)  # type: ignore[no-untyped-call]

    def answer(future: Any) -> tuple[T, R | Lost]:
        if future.status not in ("finished", "error"):
            raise CannotFinishError("the workers are gone; run the same command again to continue")
        return sent.pop(future), future.result() if future.status == "finished" else Lost(MAX_TRIES)

    try:
        for item in items:
            future = client.submit(work, item, pure=False)
            sent[future] = item
            ended.add(future)  # type: ignore[no-untyped-call]
            # What is done is told at once: a caller that is killed while it sends loses nothing that was finished.
            while len(sent) >= MAX_PENDING_TASKS or ended.has_ready():  # type: ignore[no-untyped-call]
                yield answer(next(ended))
        for future in ended:
            yield answer(future)
    finally:
        client.cancel(list(sent))


def _timed(attempt: Callable[[Task], Row], wanted: tuple[Task, str]) -> tuple[Row, Row]:
    """Make a row, and say what it took; runs on the worker. Only a worker's death ends without a row."""
    task, _ = wanted
    began = time.perf_counter()
    try:
        row = attempt(task)
    except Exception as error:
        row = failure(task.key, f"{type(error).__name__}: {error}")
    return row, {"seconds": time.perf_counter() - began, "worker": f"{socket.gethostname()}/{os.getpid()}"}


def failure(key: str, reason: str) -> Row:
    """Make the row of a task that gave none."""
    return {"key": key, "error": " ".join(reason.split())}
