"""The worker processes of a pool, each started when it is first needed and replaced when it is lost.

Each is kept from harming this machine by the model's code. It is limited in memory and file size and gives up, for good
and before it loads the model, writing anywhere but in a scratch folder of its own (Landlock), other processes, the
network, shared memory and signals to others (seccomp). A model may read what its user may read; what it reads can go
nowhere. Not limited is the number of files in its scratch folder, and a model that forges its results in the memory it
shares with us is believed. Runs in this process (``workers=0``) are not confined at all.

A model that needs a licence server or a program of its own cannot be run confined: set ``AERO_BAYES_TRUST_FMU=1`` for
one that you trust.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.simulation import worker_main

FILE_LIMIT = 256 << 20
TRUST = "AERO_BAYES_TRUST_FMU"
SLOT_BYTES = 64  # a cache line, so that workers do not slow each other down
_FIRST_SIZE = 1 << 20


@cache
def engine_path() -> Path:
    """Return the compiled engine; CannotFinishError where the package was installed without it."""
    path = Path(__file__).with_name("_engine.abi3.so")
    if not path.is_file():
        raise CannotFinishError("the native engine is not compiled: install a C compiler and reinstall the package")
    return path


class LoadError(InputError):
    """The binary of a model cannot be loaded; the message is the loader's."""


@dataclass
class WorkerProcess:
    """A process that runs :mod:`~aero_bayes.simulation.worker_main`."""

    process: subprocess.Popen[bytes]
    commands: int
    replies: int
    folder: Path

    @classmethod
    def start(cls, parent: Path, memory: int, memory_limit: int, engine: type | None = None) -> WorkerProcess:
        """Start one with a scratch folder in `parent`."""
        folder = Path(tempfile.mkdtemp(prefix="worker-", dir=parent))
        named = []
        if engine is not None:
            named = [
                f"{engine.__module__}:{engine.__qualname__}",
                str(Path(__file__).parents[2]),
                *filter(None, sys.path),
            ]
        trusted = os.environ.get(TRUST, "") not in ("", "0")
        limit = -memory_limit - 1 if trusted else memory_limit
        command_read, command_write = os.pipe()
        reply_read, reply_write = os.pipe()
        try:
            process = subprocess.Popen(
                [sys.executable, "-I", "-S", worker_main.__file__, str(engine_path())]
                + [str(number) for number in (command_read, reply_write, memory, limit, FILE_LIMIT)]
                + named,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(command_read, reply_write, memory),
                start_new_session=True,
                cwd=folder,
                env=os.environ | {"TMPDIR": str(folder), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        finally:
            os.close(command_read)
            os.close(reply_write)
        return cls(process, command_write, reply_read, folder)

    def send(self, command: int, size: int, job: int, slot: int, first: int, path: bytes) -> None:
        """Write one command, see :data:`worker_main.HEADER`."""
        data = worker_main.HEADER.pack(command, size, job, slot, first, len(path)) + path
        try:
            while data:
                data = data[os.write(self.commands, data) :]
        except BrokenPipeError:
            pass  # found dead when its reply is awaited

    @property
    def computing_time(self) -> int | None:
        """Processor time of the process in ns; None where it cannot be told."""
        if not sys.platform.startswith("linux"):
            return None
        with contextlib.suppress(OSError):
            return time.clock_gettime_ns((~self.process.pid << 3) | 2)  # its id as clock_getcpuclockid gives it
        return None

    def stop(self) -> None:
        """Kill the process and whatever it started, and remove its folder."""
        os.close(self.commands)
        os.close(self.replies)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


NO_TASK = -1
INVALID_TASK = -2


class WorkerGroup:
    """As many workers as slots of the memory that they share.

    In its slot a worker says what it is doing; behind the slots is a job with its values and results."""

    def __init__(self, size: int, folder: Path, memory_limit: int, engine: type | None = None) -> None:
        self.workers: list[WorkerProcess | None] = [None] * size
        self.replaced = self.recycled = 0
        self._folder, self._memory_limit, self._engine = folder, memory_limit, engine
        self._slots = max(1, size)
        if hasattr(os, "memfd_create"):
            self.fd = os.memfd_create("aero-bayes")
        else:
            with tempfile.TemporaryFile(dir=folder) as stream:
                self.fd = os.dup(stream.fileno())
        self._map(_FIRST_SIZE)

    def _map(self, size: int) -> None:
        os.ftruncate(self.fd, size)
        self.memory: NDArray[np.uint8] = np.frombuffer(mmap.mmap(self.fd, size), dtype=np.uint8)
        self.slots = self.memory[: self._slots * SLOT_BYTES].view(np.int64).reshape(-1, SLOT_BYTES // 8)

    def reserve(self, size: int) -> int:
        """Offset in bytes behind which there is room for `size` bytes; grows to the next power of two."""
        start = self._slots * SLOT_BYTES
        if start + size > self.memory.size:
            self._map(1 << (start + size - 1).bit_length())
        return start

    def begin(self, index: int, problem: bytes, job: int, first: int) -> int:
        """Let a worker take tasks of a job, `first` before all others; gives the file descriptor of its replies."""
        worker = self.workers[index]
        if worker is None:
            worker = WorkerProcess.start(self._folder, self.fd, self._memory_limit, self._engine)
            self.workers[index] = worker
        self.slots[index, :3] = NO_TASK, 0, 0
        worker.send(worker_main.RUN, self.memory.size, job, index * SLOT_BYTES, first, problem)
        return worker.replies

    def forget(self, problem: bytes) -> None:
        """Free a problem that is no longer needed."""
        for worker in self.workers:
            if worker is not None:
                worker.send(worker_main.FORGET, 0, 0, 0, 0, problem)

    def task_of(self, index: int, count: int) -> tuple[int, bool]:
        """Return the task that a worker is at, NO_TASK, or INVALID_TASK beyond `count`.

        And whether it never had any."""
        task, started = (int(v) for v in self.slots[index, :2])
        return (task if NO_TASK <= task < count else INVALID_TASK), (task, started) == (NO_TASK, 0)

    def stop(self, index: int, *, lost: bool) -> None:
        """Stop a worker that is lost, or one that can do no more; the next that is asked of it starts another."""
        worker, self.workers[index] = self.workers[index], None
        self.replaced += lost
        self.recycled += not lost
        if worker is not None:
            worker.stop()
