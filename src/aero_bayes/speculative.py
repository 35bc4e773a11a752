"""Speculative execution: results that a sequential program will need are computed in forked helper processes.

The program keeps its results in a cache (:mod:`aero_bayes.checkpoint`). Helpers run the next tasks and send their
results; the program then goes on as if it were alone and finds them in the cache. So its numbers do not depend on the
number of helpers, and a helper that dies only costs time.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import TypeVar

from aero_bayes.checkpoint import ResultCache
from aero_bayes.simulation import WorkerPool
from aero_bayes.simulation.worker_main import watch_parent

T = TypeVar("T")
Task = Callable[[], object]
#: Seconds that a helper may take to end.
HELPER_EXIT_TIMEOUT = 5.0


def doubling_batches(items: Sequence[T], first: int) -> Iterator[Sequence[T]]:
    """Items in batches that double in size, so that what one batch tells the next does not depend on the helpers."""
    begin, size = 0, max(first, 1)
    while begin < len(items):
        yield items[begin : begin + size]
        begin, size = begin + size, 2 * size


@dataclass(frozen=True, eq=False)
class SpeculativeExecutor:
    """Helpers that compute results before they are needed; none where there is one core or no safe fork.

    Parameters
    ----------
    result_cache : ResultCache, optional
        Where they are looked for.
    pool : WorkerPool
        As many helpers as it has workers; each simulates in a worker of its own.
    late : callable
        Whether no further task is to be begun.
    """

    result_cache: ResultCache | None
    pool: WorkerPool
    late: Callable[[], bool] = lambda: False

    def __call__(self, tasks: Sequence[Task], told: Callable[[float], None] = lambda done: None) -> None:
        """Do tasks, in any order, of which some are about to be done; ``told`` is the share that is done."""
        count = min(self.pool.size, len(tasks))
        if self.result_cache is None or count < 2 or not _may_fork():
            return
        helper_of = dict(self._start_helper(tasks) for _ in range(count))
        try:
            self._watch(helper_of, len(tasks), told)
        except BaseException:
            for helper in helper_of.values():
                helper.kill()
            raise
        finally:
            # All first: those started later have copies of the earlier connections.
            for connection in helper_of:
                connection.close()
            for helper in helper_of.values():
                helper.join(HELPER_EXIT_TIMEOUT)
                helper.kill()
                helper.join()

    def _start_helper(self, tasks: Sequence[Task]) -> tuple[Connection, BaseProcess]:
        ours, theirs = multiprocessing.Pipe()
        helper = multiprocessing.get_context("fork").Process(target=self._help, args=(tasks, ours, theirs), daemon=True)
        with warnings.catch_warnings():
            # A helper takes no lock that another thread may hold: it neither draws progress nor writes a file.
            warnings.simplefilter("ignore", DeprecationWarning)
            helper.start()
        theirs.close()
        return ours, helper

    def _help(self, tasks: Sequence[Task], ours: Connection, theirs: Connection) -> None:
        """Do what is asked for until nobody asks any more."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        threading.Thread(target=watch_parent, args=(os.getppid(),), daemon=True).start()
        ours.close()
        self.pool.use_one_worker()
        assert self.result_cache is not None
        with suppress(EOFError, BrokenPipeError):
            while True:
                task, known = theirs.recv(), self.result_cache.known()
                # What goes wrong here goes wrong again where it is asked for.
                with suppress(Exception):
                    tasks[task]()
                theirs.send(self.result_cache.beyond(known))

    def _watch(self, helper_of: dict[Connection, BaseProcess], count: int, told: Callable[[float], None]) -> None:
        """Hand out the tasks and keep what comes back, until all are done or nobody is left."""
        assert self.result_cache is not None
        waiting, busy, done = iter(range(count)), set[Connection](), 0

        def hand_out(connection: Connection) -> None:
            task = None if self.late() else next(waiting, None)
            if task is not None:
                connection.send(task)
                busy.add(connection)

        for connection in helper_of:
            hand_out(connection)
        while busy:
            ready = wait(list(busy))
            for connection in [connection for connection in busy if connection in ready]:
                busy.remove(connection)
                with suppress(EOFError, ConnectionResetError, BrokenPipeError):
                    for key, arrays in connection.recv().items():
                        self.result_cache.put(key, arrays)
                    hand_out(connection)
                done += 1
                told(done / count)


def _may_fork() -> bool:
    """Whether a copy of this process can be trusted: elsewhere libraries keep threads that a copy lacks."""
    alone = threading.current_thread() is threading.main_thread()
    return sys.platform == "linux" and hasattr(os, "fork") and alone and not multiprocessing.current_process().daemon
