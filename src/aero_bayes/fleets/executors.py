"""Where tasks run: this machine's cores, or the workers of a Dask scheduler that the user has started."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
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
    """Processes of this machine, one a core by default, replaced when one of them dies."""

    def __init__(self, workers: int | None = None) -> None:
        self.workers = workers or len(os.sched_getaffinity(0))
        #: Tasks that are sent ahead: what is lost when a process dies, since all of the pool's futures break.
        self.window = 2 * self.workers
        self._pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.workers, context, _begin, (os.getpid(),), max_tasks_per_child=TASKS_PER_PROCESS)

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit as any executor does, with new processes where the old ones broke."""
        try:
            return self._pool.submit(fn, *args, **kwargs)
        except BrokenProcessPool:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = self._new()
            return self._pool.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes."""
        self._pool.shutdown(wait, cancel_futures=cancel_futures)

    def kill(self) -> None:
        """End the processes in the middle of their tasks."""
        for process in multiprocessing.active_children():
            process.terminate()


def _begin(parent: int) -> None:
    """Have a new process of the pool end when the parent does, however that ends."""
    # What Ctrl-C sends reaches every process; only the parent has something to say about it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=watch_parent, args=(parent,), daemon=True).start()


@contextmanager
def open_executor(dask: str | None = None, workers: int | None = None) -> Iterator[Executor]:
    """Open this machine's cores, or the workers of a running Dask scheduler."""
    if dask is None:
        pool = LocalPool(workers)
        try:
            yield pool
        except BaseException:
            pool.kill()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError("--dask needs dask.distributed: pip install 'aero-bayes[fleet]'") from None
    with ExitStack() as stack:
        where: dict[str, Any] = {"scheduler_file": dask} if dask.endswith(".json") else {"address": dask}
        if dask == "local":
            count = workers or len(os.sched_getaffinity(0))
            one_core = {"threads_per_worker": 1, "dashboard_address": None, "silence_logs": ERROR}
            cluster = LocalCluster(n_workers=count, **one_core)  # type: ignore[no-untyped-call]
            where = {"address": stack.enter_context(cluster)}
        try:
            client = Client(**where, timeout=CONNECT_TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(f"{dask}: no Dask scheduler answers there ({type(error).__name__})") from None
        yield stack.enter_context(client).get_executor()
