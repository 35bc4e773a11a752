"""One map of independent tasks over worker processes: the same results whatever their number.

Workers are new processes, for tasks that can be pickled; or copies of this one, for tasks that hold what cannot be.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, Literal, TypeVar

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
#: Tasks after which a worker process is replaced, so that what leaks cannot grow.
TASKS_PER_PROCESS = 50


@dataclass(frozen=True)
class Lost:
    """Stands for the result of a task that raised something, or whose process died ``tries`` times."""

    tries: int


def results(
    work: Callable[[T], R],
    items: Iterable[T],
    count: int,
    *,
    how: Literal["spawn", "fork"] = "spawn",
    tries: int = 1,
    late: Callable[[], bool] = lambda: False,
) -> Generator[tuple[T, R | Lost]]:
    """Yield each item with what ``work`` makes of it in ``count`` worker processes, as it comes.

    An item is taken when a process is free, and none once it is late. A process that dies takes no other item with it:
    its own is begun again up to ``tries`` times. Processes are killed where the iterator is closed before its end."""
    waiting, again = iter(items), deque[tuple[T, int]]()
    processes, done = dict[Connection, BaseProcess](), Counter[Connection]()
    busy, idle = dict[Connection, tuple[T, int]](), list[Connection]()

    def begin() -> None:
        """Give each process that is free an item, as long as there are any."""
        while len(busy) < count:
            if not again:
                again.extend((item, 1) for item in islice(waiting, 0 if late() else 1))
            if not again:
                return
            if not idle:
                connection, process = _start(work, how)
                processes[connection] = process
                idle.append(connection)
            connection = idle.pop()
            busy[connection] = again.popleft()
            with suppress(OSError):  # it died, which shows when its answer is read
                connection.send((busy[connection][0],))

    try:
        begin()
        while busy:
            ready = wait(list(busy), ASKED_EVERY)
            if not ready:
                late()  # that it tells how the time goes, too
            for connection in [connection for connection in busy if connection in ready]:
                item, tried = busy.pop(connection)
                try:
                    answer = connection.recv()
                except (EOFError, OSError):
                    _end({connection: processes.pop(connection)})
                    if tried < tries:
                        again.append((item, tried + 1))
                        continue
                    answer = Lost(tried)
                else:
                    done[connection] += 1
                    if done[connection] < TASKS_PER_PROCESS:
                        idle.append(connection)
                    else:
                        _end({connection: processes.pop(connection)})
                begin()
                yield item, answer
            begin()
    except BaseException:
        for process in processes.values():
            process.kill()
        raise
    finally:
        _end(processes)


def _start(work: Callable[[Any], Any], how: str) -> tuple[Connection, BaseProcess]:
    ours, theirs = multiprocessing.Pipe()
    copies = (ours,) if how == "fork" else ()  # what a copy of this process has open
    process = multiprocessing.get_context(how).Process(  # type: ignore[attr-defined]
        target=_serve, args=(work, os.getpid(), theirs, *copies), daemon=True
    )
    with warnings.catch_warnings(), _interrupts_later():
        # A copy takes no lock that another thread may hold: it neither draws progress nor writes a file.
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    theirs.close()
    return ours, process


def _serve(work: Callable[[Any], Any], parent: int, theirs: Connection, *copies: Connection) -> None:
    """Do what is asked for until nobody asks any more."""
    # What Ctrl-C sends reaches every process; only the parent has something to say about it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=watch_parent, args=(parent,), daemon=True).start()
    for connection in copies:
        connection.close()
    with suppress(EOFError, BrokenPipeError):
        while (asked := theirs.recv()) is not None:
            answer: Any = Lost(1)
            with suppress(Exception):
                answer = work(*asked)
            theirs.send(answer)


def _end(processes: dict[Connection, BaseProcess]) -> None:
    """Have processes end that nobody will ask any more."""
    for connection in processes:
        with suppress(OSError):
            connection.send(None)  # copies that were started later have the connection open, too
        connection.close()
    for process in processes.values():
        process.join(EXIT_TIMEOUT)
        process.kill()
        process.join()


@dataclass(frozen=True, eq=False)
class Task(Generic[R]):
    """A piece of work that depends on no other one."""

    work: Callable[[], R]
    counts: Counter[Any] = field(default_factory=Counter)


@dataclass(frozen=True, eq=False)
class ParallelMap:
    """Do tasks in worker processes that are copies of this one; here, one after the other, where these do not pay.

    That is where there is one core, no safe fork, or a single task. A task whose process dies or raises is done again
    here, which can report what goes wrong."""

    pool: WorkerPool
    late: Callable[[], bool] = lambda: False

    def __call__(self, tasks: Sequence[Task[R]], told: Told = lambda share: None) -> list[R | None]:
        """Return the results in the order of the tasks; None for those that were not begun because it was late."""
        found: dict[int, R] = {}
        begun: set[int] = set()

        def numbers() -> Iterator[int]:
            for k in range(len(tasks)):
                begun.add(k)
                yield k

        count = min(self.pool.size, len(tasks))
        if count >= 2 and _may_fork():
            work = partial(self._work, tasks)
            with closing(results(work, numbers(), count, how="fork", late=self.late)) as answers:
                for k, answer in answers:
                    if not isinstance(answer, Lost):
                        found[k], counts = answer
                        tasks[k].counts.update(counts)
                        told(len(found) / len(tasks))
        for k, task in enumerate(tasks):
            if k not in found and (k in begun or not self.late()):
                found[k] = task.work()
                told(len(found) / len(tasks))
        return [found.get(k) for k in range(len(tasks))]

    def _work(self, tasks: Sequence[Task[R]], k: int) -> tuple[R, Counter[Any]]:
        """Do a task in a copy of this process, with one worker of its own; with what was counted meanwhile."""
        self.pool.use_one_worker()
        task = tasks[k]
        before = Counter(task.counts)
        return task.work(), task.counts - before


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Keep Ctrl-C and a request to end until here is over: Python drops what is raised while it forks."""
    if threading.current_thread() is not threading.main_thread():  # which alone gets them
        yield
        return
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
