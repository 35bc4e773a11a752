"""Where tasks run: this machine's cores, or the workers of a Dask scheduler that the user has started."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from logging import ERROR
from typing import Any, ParamSpec, TypeVar

from aero_bayes.errors import InputError
from aero_bayes.simulation.worker_main import watch_parent

P = ParamSpec("P")
T = TypeVar("T")
#: Tasks after which a process of this machine is replaced, so that what leaks cannot grow.
TASKS_PER_PROCESS = 50
#: How long a scheduler is looked for, in s.
CONNECT_TIMEOUT = 20.0
#: One core is what one task gets: BLAS threads would fight the other tasks.
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class LocalPool(Executor):
    """Processes of this machine, each a pool of its own: one that dies takes no other task with it."""

    def __init__(self, workers: int) -> None:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        self._threads = ThreadPoolExecutor(workers)
        self._free: queue.SimpleQueue[ProcessPoolExecutor] = queue.SimpleQueue()
        for _ in range(workers):
            self._free.put(_process())

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run a function in the next process that is free."""
        return self._threads.submit(self._in_process, partial(fn, *args, **kwargs))

    def _in_process(self, work: Callable[[], T]) -> T:
        process = self._free.get()
        try:
            return process.submit(work).result()
        except BrokenProcessPool:
            process = _process()
            raise
        finally:
            self._free.put(process)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes once their tasks have ended."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        while not self._free.empty():
            self._free.get().shutdown(wait)

    def kill(self) -> None:
        """End the processes in the middle of their tasks."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.terminate()


def _process() -> ProcessPoolExecutor:
    """Make a pool of one process, which starts with its first task."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, context, _begin, (os.getpid(),), max_tasks_per_child=TASKS_PER_PROCESS)


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
        pool = LocalPool(count)
        try:
            yield pool
        except BaseException:
            pool.kill()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
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
