"""Rows of independent tasks, as of a fleet or a study: made here or by Dask, written to one file as they come."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from itertools import takewhile
from logging import ERROR
from pathlib import Path
from typing import Any, TypeVar

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.parallel import Lost, results

T = TypeVar("T")
Row = dict[str, Any]
#: How long a scheduler is looked for, in s.
CONNECT_TIMEOUT = 20.0
#: One core is what one task gets: BLAS threads would fight the other tasks.
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
#: How often a task is given to a worker before it counts as what killed them.
MAX_TRIES = 3


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


def read_rows(path: Path) -> dict[str, Row]:
    """Read the rows of a file by key: the last one of each; a line that was not written to its end is none."""
    try:
        lines = path.read_text("utf-8").split("\n")[:-1] if path.exists() else []
        return {row["key"]: row for row in map(json.loads, lines)}
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: not a table of rows ({error})") from None


def work_on(
    tasks: Iterable[tuple[str, T]],
    attempt: Callable[[T], Row],
    path: Path,
    more: Callable[[str], Row],
    *,
    client: Any = None,
    workers: int | None = None,
    late: Callable[[], bool] = lambda: False,
) -> Iterator[Row]:
    """Work on tasks by key. Add to each row as it comes what is ``more`` to say of its key, write it, and yield it.

    Processes of this machine do it, by default one for each core, with none this one; or the workers of a Dask client.
    What is raised becomes a row with ``error``, and so does a task whose workers died. None is begun once it is late.
    """
    work = partial(_row_of, attempt)
    answers: Generator[tuple[tuple[str, T], Row | Lost]]
    if client is not None:
        answers = _by_dask(work, tasks, client)
    elif workers == 0:
        answers = ((one, work(one)) for one in takewhile(lambda _: not late(), tasks))
    else:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        answers = results(work, tasks, workers or len(os.sched_getaffinity(0)), tries=MAX_TRIES, late=late)
    path.parent.mkdir(parents=True, exist_ok=True)
    with closing(answers), path.open("ab+") as file:
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)  # the caller may have been killed while it wrote
        for (key, _), answer in answers:
            if isinstance(answer, Lost):
                answer = {"key": key, "error": f"its worker died {MAX_TRIES} times"}
            row = {**answer, **more(key)}
            file.write(f"{json.dumps(row)}\n".encode())
            file.flush()
            yield row


def _by_dask(
    work: Callable[[tuple[str, T]], Row], tasks: Iterable[tuple[str, T]], client: Any
) -> Generator[tuple[tuple[str, T], Row | Lost]]:
    """Yield each task with what the workers of a client make of it. Dask gives the task of a dead worker to another."""
    from distributed import as_completed

    sent = {client.submit(work, one, pure=False): one for one in tasks}
    try:
        for future in as_completed(list(sent), loop=client.loop):  # type: ignore[no-untyped-call]
            if future.status not in ("finished", "error"):
                raise CannotFinishError("the workers are gone; run the same command again to continue")
            yield sent.pop(future), future.result() if future.status == "finished" else Lost(MAX_TRIES)
    finally:
        client.cancel(list(sent))


def _row_of(attempt: Callable[[T], Row], one: tuple[str, T]) -> Row:
    """Make the row of a key and its task, with the time that it took; runs on the worker."""
    key, task = one
    began = time.perf_counter()
    try:
        row = attempt(task)
    except Exception as error:
        row = {"error": " ".join(f"{type(error).__name__}: {error}".split())}
    return {"seconds": round(time.perf_counter() - began, 2), **row, "key": key}
