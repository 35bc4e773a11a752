"""Writing a file whole or not at all, and a folder by one run at a time."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.locks import lock

#: In the output folder: from where ``--resume`` continues, and what a run found.
CHECKPOINT, RESULT = "checkpoint.npz", "result.json"


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name that takes the place of ``path``, once the disk holds it, if the block ends well."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        _to_disk(temporary)
        temporary.replace(path)
        _to_disk(path.parent)
    except OSError as error:
        error.filename = error.filename or str(path)  # a full disk does not say which file it had no room for
        raise
    finally:
        temporary.unlink(missing_ok=True)


def _to_disk(path: Path) -> None:
    """Wait until the disk holds the content of a file, or the names in a folder, where a system can open one."""
    if sys.platform == "win32" and path.is_dir():
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def one_run_at_a_time(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder, which is made, until the block ends; the system ends it for a run that dies."""
    folder.mkdir(parents=True, exist_ok=True)
    windows = sys.platform == "win32"  # opens no folders: a file inside is locked there
    handle = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT) if windows else os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some network file systems lock no folders
            try:
                lock(handle)
            except (BlockingIOError, PermissionError):
                raise InputError(
                    f"{folder}: another run is writing there; wait for its end or give another --out"
                ) from None
        yield
    finally:
        os.close(handle)
