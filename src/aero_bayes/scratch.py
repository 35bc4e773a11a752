"""Temporary folders that outlive no process for long.

Each holds a lock file that its process keeps locked. The system drops the lock however the process ends, so that the
next start can tell a folder in use from one that a killed process left behind, and removes the latter.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from functools import cache
from pathlib import Path
from types import TracebackType

from aero_bayes.locks import AVAILABLE
from aero_bayes.locks import lock as lock_file

PREFIX = "aero-bayes-"
_LOCK = ".aero-bayes-scratch"


def _remove(path: Path, lock: int, owner: int) -> None:
    if os.getpid() != owner:
        return  # a forked child: the folder is its parent's
    for entry in list(path.iterdir()) if path.is_dir() else []:
        if entry.name == _LOCK:
            continue  # last, or what is left after a kill right here would look like nobody's
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)
    shutil.rmtree(path, ignore_errors=True)
    os.close(lock)


def sweep(parent: Path) -> int:
    """Remove the scratch folders in ``parent`` whose process is gone."""
    removed = 0
    if not AVAILABLE:
        return removed
    for path in parent.glob(f"{PREFIX}*/{_LOCK}"):
        try:
            own = not hasattr(os, "getuid") or path.parent.stat().st_uid == os.getuid()
            if path.parent.is_symlink() or not own:
                continue
            lock = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
        except OSError:
            continue
        try:
            lock_file(lock)
        except OSError:
            os.close(lock)
            continue
        _remove(path.parent, lock, os.getpid())
        removed += 1
    return removed


@cache
def _sweep_once(parent: Path) -> None:
    sweep(parent)


class ScratchFolder:
    """A private temporary folder, removed when it is closed, collected or its process ends.

    Where the process is killed, the next process that makes one removes it. As a context manager it gives its path."""

    def __init__(self) -> None:
        _sweep_once(Path(tempfile.gettempdir()))
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX))
        unlocked = self.path / f"{_LOCK}.part"
        lock = os.open(unlocked, os.O_RDWR | os.O_CREAT, 0o600)
        lock_file(lock, wait=True)
        unlocked.rename(self.path / _LOCK)  # nobody sees it before it is locked
        self._finalizer = weakref.finalize(self, _remove, self.path, lock, os.getpid())

    def __enter__(self) -> Path:
        return self.path

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Remove the folder and what is in it."""
        self._finalizer()
