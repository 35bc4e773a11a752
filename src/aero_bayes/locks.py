"""Locks on files that the system drops however a process ends; nothing where a system has none that Python knows."""

from __future__ import annotations

import sys

#: Whether there are locks: without them nobody can tell whether a file or folder is in use.
AVAILABLE = True

if sys.platform == "win32":
    import msvcrt

    def lock(handle: int, *, wait: bool = False) -> None:
        """Lock the first byte of an open file; OSError where another process holds it."""
        msvcrt.locking(handle, msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)

else:
    try:
        import fcntl
    except ImportError:  # a Python without it, as in a browser
        AVAILABLE = False

        def lock(handle: int, *, wait: bool = False) -> None:
            """Do nothing: there are no locks here."""

    else:

        def lock(handle: int, *, wait: bool = False) -> None:
            """Lock an open file or folder; BlockingIOError where another process holds it and we do not wait."""
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
