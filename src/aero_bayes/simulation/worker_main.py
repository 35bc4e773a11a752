"""A worker process: maps the shared memory, opens problems, runs batches. Needs only the standard library.

Started as ``python -I -S worker_main.py ENGINE COMMAND_FD REPLY_FD ARENA_FD MEMORY FILE``, the last two in bytes
(MEMORY negative: unconfined), in the folder that it may write to. It does not import the package, so that it starts in
a few hundredths of a second and holds nothing that a crash could spoil. Where another engine is named
(``MODULE:CLASS``, then the folders to import from), that one runs the batches in place of the compiled one.
"""

from __future__ import annotations

import ctypes
import importlib
import mmap
import os
import struct
import sys
import threading
import time

TYPE_CHECKING = False  # importing typing would take a third of the start
if TYPE_CHECKING:
    from typing import Any

HEADER = struct.Struct("<6q")  # command, arena size, job offset, slot offset, first task, length of the path
RUN, FORGET = 1, 2
# The words of a job in shared memory, in order, as native/batch.c reads them.
JOB_WORDS = (
    "next", "total", "mode", "experiments", "p", "q", "noise_by_row", "noise_by_experiment", "values", "noise",
    "columns", "outcomes", "steps", "numbers", "stride", "table",
)  # fmt: skip
SPENT, NOT_LOADED = 1, 2  # how a batch ends where this process can do no more, and where the model cannot be loaded
MAX_PROBLEMS = 512


def watch_parent(parent: int) -> None:
    """End this process, even inside a hanging model, when the parent is gone."""
    while os.getppid() == parent:
        time.sleep(2.0)
    os._exit(3)


def read_exactly(fd: int, size: int) -> bytes:
    """`size` bytes, or the end of the process where the other end is closed."""
    data = b""
    while len(data) < size:
        part = os.read(fd, size - len(data))
        if not part:
            os._exit(0)
        data += part
    return data


def load_engine(path: str) -> ctypes.CDLL:
    """Return the engine with its argument types."""
    engine = ctypes.CDLL(path)
    engine.ab_open.restype = ctypes.c_void_p
    engine.ab_open.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_size_t]
    engine.ab_close.restype = None
    engine.ab_close.argtypes = [ctypes.c_void_p]
    engine.ab_batch.restype = ctypes.c_int
    engine.ab_load_error.restype = ctypes.c_char_p
    engine.ab_load_error.argtypes = [ctypes.c_void_p]
    engine.ab_confine.argtypes = [ctypes.c_char_p, ctypes.c_int64, ctypes.c_int64]
    engine.ab_limit.restype = None
    engine.ab_limit.argtypes = [ctypes.c_int64]
    engine.ab_batch.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64]
    return engine


def serve(engine: Any, commands: int, replies: int, arena: int) -> None:
    """Answer commands until the pipe closes."""
    problems: dict[bytes, Any] = {}
    size, base, memory = 0, 0, None
    while True:
        command, wanted, job, slot, first, length = HEADER.unpack(read_exactly(commands, HEADER.size))
        path = read_exactly(commands, length)
        if command == FORGET:
            if path in problems:
                engine.ab_close(problems.pop(path))
            continue
        if wanted != size:
            memory = mmap.mmap(arena, wanted)
            base = ctypes.addressof(ctypes.c_char.from_buffer(memory))
            size = wanted
        problem = problems.get(path)
        if problem is None:
            while len(problems) >= MAX_PROBLEMS:
                engine.ab_close(problems.pop(next(iter(problems))))
            error = ctypes.create_string_buffer(1024)
            problem = engine.ab_open(path, error, 1024)
            if not problem:
                os.write(replies, b"e" + error.value[:1000] + b"\n")
                continue
            problems[path] = problem
        ended = engine.ab_batch(problem, base, base + job, base + slot, first)
        if ended == NOT_LOADED:
            os.write(replies, b"l" + engine.ab_load_error(problem)[:1000] + b"\n")
        else:
            os.write(replies, b"r" if ended else b"d")


if __name__ == "__main__":
    loaded = load_engine(sys.argv[1])
    memory_limit, file_limit = int(sys.argv[5]), int(sys.argv[6])
    if memory_limit >= 0:  # before any other thread, which would stay free
        loaded.ab_confine(b".", 2 * memory_limit, file_limit)
    threading.Thread(target=watch_parent, args=(os.getppid(),), daemon=True).start()
    loaded.ab_limit(abs(memory_limit))
    engine: Any = loaded
    if len(sys.argv) > 7:
        module, _, name = sys.argv[7].partition(":")
        sys.path[:] = sys.argv[8:]
        engine = getattr(importlib.import_module(module), name)(loaded)
    serve(engine, int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
