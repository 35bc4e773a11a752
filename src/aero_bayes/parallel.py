"""A parallel map of independent tasks over forked worker processes: the same results whatever their number."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from aero_bayes.simulation.worker_main import watch_parent
from aero_bayes.simulation.workers import WorkerPool

T = TypeVar("T")
R = TypeVar("R")
#: Told the share of the tasks that is done.
Told = Callable[[float], object]
#: Seconds that a worker process may take to end.
EXIT_TIMEOUT = 5.0
#: Seconds after which it is asked whether it is late where no task ends meanwhile.
ASKED_EVERY = 1.0


@dataclass(frozen=True, eq=False)
class Task(Generic[R]):
    """A piece of work that depends on no other one."""

    work: Callable[[], R]
    counts: Counter[Any] = field(default_factory=Counter)


@dataclass(frozen=True, eq=False)
class ParallelMap:
    """Do tasks in worker processes that are copies of this one; here, one after the other, where these do not pay.

    That is where there is one core, no safe fork, or a single task. A task whose process dies or raises is done again
    here."""

    pool: WorkerPool
    late: Callable[[], bool] = lambda: False

    def __call__(self, tasks: Sequence[Task[R]], told: Told = lambda share: None) -> list[R | None]:
        """Return the results in the order of the tasks; None for those that were not begun because it was late."""
        found: dict[int, R] = {}
        count = min(self.pool.size, len(tasks))
        begun = self._in_workers(tasks, count, found, told) if count >= 2 and _may_fork() else set[int]()
        for k, task in enumerate(tasks):
            if k not in found and (k in begun or not self.late()):
                found[k] = task.work()
                told(len(found) / len(tasks))
        return [found.get(k) for k in range(len(tasks))]

    def _in_workers(self, tasks: Sequence[Task[R]], count: int, found: dict[int, R], told: Told) -> set[int]:
        """Fill in what workers find; gives the tasks that were begun."""
        processes = dict(self._start(tasks) for _ in range(count))
        try:
            return self._hand_out(list(processes), tasks, found, told)
        except BaseException:
            for process in processes.values():
                process.kill()
            raise
        finally:
            # All first: those started later have copies of the earlier connections.
            for connection in processes:
                connection.close()
            for process in processes.values():
                process.join(EXIT_TIMEOUT)
                process.kill()
                process.join()

    def _start(self, tasks: Sequence[Task[R]]) -> tuple[Connection, BaseProcess]:
        ours, theirs = multiprocessing.Pipe()
        process = multiprocessing.get_context("fork").Process(
            target=self._work, args=(tasks, ours, theirs), daemon=True
        )
        with warnings.catch_warnings(), _interrupts_later():
            # A worker takes no lock that another thread may hold: it neither draws progress nor writes a file.
            warnings.simplefilter("ignore", DeprecationWarning)
            process.start()
        theirs.close()
        return ours, process

    def _work(self, tasks: Sequence[Task[R]], ours: Connection, theirs: Connection) -> None:
        """Do what is asked for until nobody asks any more."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        threading.Thread(target=watch_parent, args=(os.getppid(),), daemon=True).start()
        ours.close()
        self.pool.use_one_worker()
        with suppress(EOFError, BrokenPipeError):
            while True:
                task = tasks[theirs.recv()]
                before, answer = Counter(task.counts), None
                # What goes wrong here goes wrong again in the process that asked, which can report it.
                with suppress(Exception):
                    answer = task.work(), task.counts - before
                theirs.send(answer)

    def _hand_out(
        self, connections: Sequence[Connection], tasks: Sequence[Task[R]], found: dict[int, R], told: Told
    ) -> set[int]:
        """Hand out the tasks in order and keep what comes back, until all are done or no worker is left."""
        waiting, busy, begun = iter(range(len(tasks))), dict[Connection, int](), set[int]()

        def hand_out(connection: Connection) -> None:
            k = None if self.late() else next(waiting, None)
            if k is not None:
                begun.add(k)
                busy[connection] = k
                connection.send(k)

        for connection in connections:
            hand_out(connection)
        while busy:
            ready = wait(list(busy), ASKED_EVERY)
            if not ready:
                self.late()  # that it tells how the time goes, too
            for connection in [connection for connection in busy if connection in ready]:
                k = busy.pop(connection)
                with suppress(EOFError, ConnectionResetError, BrokenPipeError):
                    answer = connection.recv()
                    if answer is not None:
                        found[k] = answer[0]
                        tasks[k].counts.update(answer[1])
                        told(len(found) / len(tasks))
                    hand_out(connection)
        return begun


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Keep Ctrl-C and a request to end until here is over: Python drops what is raised while it forks."""
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
    for interrupt in came:
        signal.raise_signal(interrupt)


def _may_fork() -> bool:
    """Return whether a copy of this process can be trusted: elsewhere libraries keep threads that a copy lacks."""
    alone = threading.current_thread() is threading.main_thread()
    return sys.platform == "linux" and hasattr(os, "fork") and alone and not multiprocessing.current_process().daemon
