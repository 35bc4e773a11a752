"""One worker process: how it is started, told what to do, timed and stopped."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from aero_bayes.simulation import confinement, worker_main
from aero_bayes.simulation.engine_library import engine_path


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
        limit = -memory_limit - 1 if confinement.is_trusted() else memory_limit
        command_read, command_write = os.pipe()
        reply_read, reply_write = os.pipe()
        try:
            process = subprocess.Popen(
                [sys.executable, "-I", "-S", worker_main.__file__, str(engine_path())]
                + [str(number) for number in (command_read, reply_write, memory, limit, confinement.FILE_LIMIT)]
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
