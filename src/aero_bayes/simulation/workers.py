"""Worker processes that run other people's native code, and the clock that watches them.

Values and results pass through one shared block of memory; a pipe to each worker carries a few bytes a batch. A worker
takes one task at a time from a shared counter, so a crash or a hang costs exactly the run that caused it.
"""

from __future__ import annotations

import contextlib
import ctypes
import mmap
import os
import select
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.scratch import ScratchFolder
from aero_bayes.simulation import confinement, worker_main
from aero_bayes.simulation.interface import Outcome
from aero_bayes.simulation.model import Model

TODO = 255
INVALID_REPLY = -2
_SLOT_BYTES = 64
_SLOTS_AT = 0  # slots come first in the arena
_FIRST_ARENA = 1 << 20
MAX_LOST_RUNS = 24  # runs of a model: where its first ones all crashed or ran out of time no further one is begun
MAX_SILENCE = 60.0  # s after which a worker that is at no task and does not say so counts as lost
WALL_CLOCK_FACTOR = 10.0  # time limits on the wall clock after which a run that sleeps, or gets no processor, is ended


@cache
def engine_path() -> Path:
    """The compiled engine; CannotFinishError where the package was installed without it."""
    folder = Path(__file__).parent
    for name in ("_engine" + str(sysconfig.get_config_var("EXT_SUFFIX")), "_engine.abi3.so", "_engine.so"):
        if (folder / name).is_file():
            return folder / name
    raise CannotFinishError(
        "the native engine is not compiled: install a C compiler and reinstall the package, or use --engine fmpy"
    )


class LoadError(InputError):
    """The binary of a model cannot be loaded; the message is the loader's."""


@dataclass
class _Worker:
    process: subprocess.Popen[bytes]
    commands: int
    replies: int
    folder: Path

    def send(self, command: int, size: int, job: int, slot: int, first: int, path: bytes) -> None:
        data = worker_main.HEADER.pack(command, size, job, slot, first, len(path)) + path
        try:
            while data:
                data = data[os.write(self.commands, data) :]
        except BrokenPipeError:
            pass  # found dead when its reply is awaited

    @property
    def computed(self) -> int | None:
        """Computing time of the process in ns; None where it cannot be told."""
        if not sys.platform.startswith("linux"):
            return None
        with contextlib.suppress(OSError):
            return time.clock_gettime_ns((~self.process.pid << 3) | 2)  # its id as clock_getcpuclockid gives it
        return None

    def stop(self) -> None:
        os.close(self.commands)
        os.close(self.replies)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)  # with whatever it started
        self.process.kill()
        self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def _stop(workers: list[_Worker | None], owner: int) -> None:
    if os.getpid() != owner:
        return
    for index, worker in enumerate(workers):
        if worker is not None:
            worker.stop()
            workers[index] = None


class WorkerPool:
    """Worker processes shared by any number of simulators.

    Parameters
    ----------
    workers : int, optional
        Number of processes; the machine's usable cores by default. 0 runs everything in this process: less overhead,
        no protection against a model that crashes or hangs.
    memory_limit : int
        Bytes of its own memory beyond which a worker is recycled: it ends between two runs and another goes on, so
        that a model that leaks does not fill the machine. At twice of it the model gets no more. 0 for no limit.
    cosimulation : bool
        Workers in which FMPy runs co-simulation FMUs. They take about a second to start.

    Notes
    -----
    Workers are confined as far as the kernel allows (:mod:`aero_bayes.simulation.confinement`).
    """

    def __init__(self, workers: int | None = None, memory_limit: int = 1 << 30, *, cosimulation: bool = False) -> None:
        if workers is None:
            workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self.size = workers
        self.lock = threading.RLock()
        self.memory_limit = memory_limit
        self._cosimulation = cosimulation
        self.replaced = self.recycled = 0
        self._workers: list[_Worker | None] = [None] * workers
        self._scratch = ScratchFolder()
        self.folder = self._scratch.path
        self._binaries: dict[str, Path] = {}
        self._counter = 0
        self._creator = self._owner = os.getpid()
        self._problems: dict[bytes, int] = {}
        self._first: dict[str, NDArray[np.uint8]] = {}  # how the first runs of each model ended
        self._engine = worker_main.load(str(engine_path())) if workers == 0 else None
        self._new_arena(_FIRST_ARENA)
        self._finalizer = weakref.finalize(self, _stop, self._workers, self._owner)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop the workers and remove what was unpacked."""
        for path in list(self._problems):
            self.forget(Path(os.fsdecode(path)))
        self._finalizer()
        self._scratch.close()

    @property
    def processes(self) -> tuple[int, ...]:
        """Process ids of the workers that run."""
        return tuple(worker.process.pid for worker in self._workers if worker is not None)

    def alone(self) -> None:
        """In a forked child: one worker from now on."""
        self.size = min(self.size, 1)

    def binary(self, model: Model) -> Path:
        """The model's binary, unpacked once into a private folder."""
        with self.lock:
            if model.sha256 not in self._binaries:
                folder = Path(tempfile.mkdtemp(prefix="fmu-", dir=self.folder))
                self._binaries[model.sha256] = model.unpack(folder)
            return self._binaries[model.sha256]

    def new_path(self) -> Path:
        """A name for a new problem file."""
        with self.lock:
            self._counter += 1
            return self.folder / f"problem-{os.getpid()}-{self._counter}"

    def forget(self, path: Path) -> None:
        """The problem at this path is no longer needed."""
        with self.lock:
            key = os.fsencode(path)
            if self._engine is not None and key in self._problems:
                self._engine.ab_close(self._problems.pop(key))
            if os.getpid() == self._owner:
                for worker in self._workers:
                    if worker is not None:
                        worker.send(worker_main.FORGET, 0, 0, 0, 0, key)
            if os.getpid() == self._creator:
                path.unlink(missing_ok=True)

    def _new_arena(self, size: int) -> None:
        if hasattr(os, "memfd_create"):
            self._arena_fd = os.memfd_create("aero-bayes")
        else:
            with tempfile.TemporaryFile(dir=self.folder) as stream:
                self._arena_fd = os.dup(stream.fileno())
        self._map_arena(size)

    def _map_arena(self, size: int) -> None:
        os.ftruncate(self._arena_fd, size)
        self.arena: NDArray[np.uint8] = np.frombuffer(mmap.mmap(self._arena_fd, size), dtype=np.uint8)
        slots = self.arena[: max(1, self.size) * _SLOT_BYTES].view(np.int64).reshape(-1, _SLOT_BYTES // 8)
        self._slots = slots

    def reserve(self, size: int) -> tuple[NDArray[np.uint8], int]:
        """The shared memory, at least `size` bytes behind the returned offset. Hold :attr:`lock` while it is in use."""
        if os.getpid() != self._owner:  # a forked child gets workers of its own
            self._owner = os.getpid()
            self._finalizer.detach()
            self._workers = [None] * self.size
            self._new_arena(_FIRST_ARENA)
        start = max(1, self.size) * _SLOT_BYTES
        if start + size > self.arena.size:
            self._map_arena(1 << (start + size - 1).bit_length())
        return self.arena, start

    def run(self, path: Path, job: int, outcomes: NDArray[np.uint8], time_limit: float, model: str) -> None:
        """Run the job at this offset of the shared memory until every task has an outcome.

        A model (its hash) whose first runs all crashed or ran out of time is run no more: what is left ends like them.

        Raises
        ------
        LoadError
            Where the model's binary cannot be loaded.
        """
        key = os.fsencode(path)
        if not outcomes.size:
            return
        if self._engine is not None:
            self._run_here(key, job, outcomes)
            return
        before = self._first.get(model, outcomes[:0])

        def hopeless() -> bool:
            first = self._first[model] = np.concatenate((before, outcomes[outcomes != TODO]))[:MAX_LOST_RUNS]
            lost = first.size == MAX_LOST_RUNS and bool(np.all(np.isin(first, (Outcome.TIMED_OUT, Outcome.CRASHED))))
            if lost:
                outcomes[outcomes == TODO] = first[-1]
            return lost

        if hopeless():
            return
        active: dict[int, int] = {}
        for index in range(min(self.size, outcomes.size)):
            self._command(index, key, job, -1, active)
        try:
            self._watch(key, job, outcomes, time_limit, active, hopeless)
        except BaseException:  # an interrupt must not leave a worker in the middle of a job
            for index in active.values():
                self._replace(index)
            raise

    def _run_here(self, key: bytes, job: int, outcomes: NDArray[np.uint8]) -> None:
        assert self._engine is not None
        if key not in self._problems:
            error = ctypes.create_string_buffer(1024)
            problem = self._engine.ab_open(key, error, 1024)
            if not problem:
                raise CannotFinishError(error.value.decode(errors="replace"))
            self._problems[key] = problem
        problem, base = self._problems[key], self.arena.ctypes.data
        while ended := self._engine.ab_batch(problem, base, base + job, base + _SLOTS_AT, -1):
            if ended == worker_main.NOT_LOADED:
                raise LoadError(self._engine.ab_load_error(problem).decode(errors="replace"))
            outcomes[int(self._slots[0, 0])] = Outcome.MODEL_ERROR  # no other process is there to instantiate it in

    def counts(self, path: Path, experiment: int = 0) -> tuple[int, int, int]:
        """Accepted steps, rejected steps and derivative evaluations of the last run (only with ``workers=0``)."""
        out = (ctypes.c_int64 * 3)()
        if self._engine is None or self._engine.ab_counts(self._problems[os.fsencode(path)], experiment, out):
            raise CannotFinishError("no run to count")
        return out[0], out[1], out[2]

    def _command(self, index: int, key: bytes, job: int, first: int, active: dict[int, int]) -> None:
        worker = self._workers[index]
        if worker is None:
            worker = self._workers[index] = self._start()
        self._slots[index, :3] = -1, 0, 0
        worker.send(worker_main.RUN, self.arena.size, job, _SLOTS_AT + index * _SLOT_BYTES, first, key)
        active[worker.replies] = index

    def _start(self) -> _Worker:
        folder = Path(tempfile.mkdtemp(prefix="worker-", dir=self.folder))
        found = [str(Path(__file__).parents[2]), *filter(None, sys.path)] if self._cosimulation else []
        memory = -self.memory_limit - 1 if confinement.is_trusted() else self.memory_limit
        command_read, command_write = os.pipe()
        reply_read, reply_write = os.pipe()
        try:
            process = subprocess.Popen(
                [sys.executable, "-I", "-S", worker_main.__file__, str(engine_path())]
                + [str(fd) for fd in (command_read, reply_write, self._arena_fd, memory, confinement.FILE_LIMIT)]
                + found,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(command_read, reply_write, self._arena_fd),
                start_new_session=True,
                cwd=folder,
                env=os.environ | {"TMPDIR": str(folder), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        finally:
            os.close(command_read)
            os.close(reply_write)
        return _Worker(process, command_write, reply_read, folder)

    def _replace(self, index: int) -> None:
        worker = self._workers[index]
        self._workers[index] = None
        if worker is not None:
            worker.stop()
            self.replaced += 1

    def _recycle(self, index: int) -> None:
        self._replace(index)
        self.replaced -= 1
        self.recycled += 1

    def _watch(
        self, key: bytes, job: int, outcomes: NDArray[np.uint8], time_limit: float, active: dict[int, int],
        hopeless: Callable[[], bool],
    ) -> None:  # fmt: skip
        """Until every task has an outcome. What workers write is not believed where it cannot be true: a model's code
        reaches the pipe and the shared memory, too."""
        poller = select.poll()
        for fd in active:
            poller.register(fd, select.POLLIN)
        patience = min(250.0, max(5.0, 250.0 * time_limit))
        early_deaths = 0
        retried: set[int] = set()
        silent: dict[int, int] = {}  # when a worker was first seen without a task, ns

        def drop(fd: int) -> None:
            poller.unregister(fd)
            silent.pop(active.pop(fd), None)

        def proceed(index: int, task: int, end: Outcome, *, retry: bool) -> None:
            """Another worker takes over; the task that was under way ends so, or is tried once more."""
            again = retry and task >= 0 and outcomes[task] == TODO and task not in retried
            if again:
                retried.add(task)
            elif task >= 0 and outcomes[task] == TODO:
                outcomes[task] = end
            if np.any(outcomes == TODO):
                self._command(index, key, job, task if again else -1, active)
                worker = self._workers[index]
                assert worker is not None
                poller.register(worker.replies, select.POLLIN)

        while active:
            for fd, _ in poller.poll(patience):
                index = active[fd]
                reply = os.read(fd, 2048)
                task, fresh = self._slot(index, outcomes.size)
                if reply == b"d" and task == -1:
                    drop(fd)
                elif reply == b"r":  # full, or a task met an FMU that cannot be instantiated again
                    drop(fd)
                    self._recycle(index)
                    proceed(index, task, Outcome.MODEL_ERROR, retry=True)
                elif reply[:1] in (b"e", b"l") and fresh:
                    kind = LoadError if reply[:1] == b"l" else CannotFinishError
                    raise kind(reply[1:].decode(errors="replace").strip())
                else:
                    drop(fd)
                    self._replace(index)
                    early_deaths += fresh
                    if early_deaths > 8:
                        raise CannotFinishError("worker processes of the native engine die as soon as they start")
                    proceed(index, task, Outcome.CRASHED, retry=True)
            now = time.monotonic_ns()
            clocks = {index: worker.computed for index in active.values() if (worker := self._workers[index])}
            allowed = 1e9 * (time_limit + 0.05 + 0.1 * time_limit)
            for fd, index in list(active.items()):
                task, _ = self._slot(index, outcomes.size)
                started, spent = (int(v) for v in self._slots[index, 1:3])
                if task < 0:
                    # nonsense is a model's writing, which runs no longer than any other
                    patient = allowed if task == INVALID_REPLY else max(1e9 * MAX_SILENCE, 2.0 * allowed)
                    if now - silent.setdefault(index, now) < patient:
                        continue
                else:
                    silent.pop(index, None)
                    computed = clocks[index]
                    waits = WALL_CLOCK_FACTOR if computed is not None else 1.0
                    # It may have begun another since the clocks were read.
                    if abs(now - started) < waits * allowed and abs((computed or spent) - spent) < allowed:
                        continue
                drop(fd)
                self._replace(index)
                proceed(index, task, Outcome.TIMED_OUT, retry=False)
            if hopeless():
                for index in active.values():
                    self._replace(index)
                break
        lost = outcomes > max(Outcome)  # TODO is one of them: tasks that nobody knows of any more
        outcomes[lost] = Outcome.CRASHED

    def _slot(self, index: int, tasks: int) -> tuple[int, bool]:
        """The task that a worker is at, -1 for none, or INVALID_REPLY; and whether it has never been at one."""
        task, started = (int(v) for v in self._slots[index, :2])
        return (task if -1 <= task < tasks else INVALID_REPLY), (task, started) == (-1, 0)
