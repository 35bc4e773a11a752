"""Files that are written whole or not at all, what is kept between runs, folders for one run, temporary folders."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from aero_bayes.errors import InputError

try:
    import fcntl
except ImportError:  # on Windows, in a browser: nobody can tell there whether a folder is in use
    fcntl = None  # type: ignore[assignment]

#: In the output folder: from where ``--resume`` continues, and what a run found.
CHECKPOINT, RESULT = "checkpoint.npz", "result.json"
#: How the names of temporary folders begin and end.
_PREFIX, _SUFFIX = "aero-bayes-", ".scratch"


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


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file whole or not at all, text in UTF-8; return its path."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
    return path


def _to_disk(path: Path) -> None:
    """Wait until the disk holds the content of a file, or the names in a folder, where a system can open one."""
    if sys.platform == "win32" and path.is_dir():
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _lock(folder: Path) -> int | None:
    """Lock a folder until what this returns is closed or the process ends, however it does.

    BlockingIOError where another process holds it, None where there are no locks."""
    if fcntl is None:
        return None
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


@contextmanager
def one_run_at_a_time(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder, which is made, until the block ends."""
    folder.mkdir(parents=True, exist_ok=True)
    handle = None
    try:
        with suppress(OSError):  # some network file systems lock no folders
            try:
                handle = _lock(folder)
            except BlockingIOError:
                raise InputError(
                    f"{folder}: another run is writing there; wait for its end or give another --out"
                ) from None
        yield
    finally:
        if handle is not None:
            os.close(handle)


def sweep(parent: Path) -> int:
    """Remove the temporary folders in ``parent`` whose process is gone."""
    removed = 0
    for path in parent.glob(f"{_PREFIX}*{_SUFFIX}"):
        with suppress(OSError):  # in use, or another user's
            lock = None if path.is_symlink() else _lock(path)
            if lock is None:
                continue
            if os.fstat(lock).st_uid == os.getuid():
                shutil.rmtree(path, ignore_errors=True)
                removed += 1
            os.close(lock)
    return removed


_sweep_once = cache(sweep)


class ScratchFolder:
    """A private temporary folder, removed when it is closed, collected or its process ends.

    Where the process is killed, the next process that makes one removes it. As a context manager it gives its path."""

    def __init__(self) -> None:
        _sweep_once(Path(tempfile.gettempdir()))
        new = Path(tempfile.mkdtemp(prefix=f"new-{_PREFIX}", suffix=_SUFFIX))
        lock = _lock(new)
        self.path = new.rename(new.with_name(new.name.removeprefix("new-")))  # nobody sweeps it before it is locked
        self._finalizer = weakref.finalize(self, _remove, self.path, lock, os.getpid())

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the folder and what is in it."""
        self._finalizer()


def _remove(path: Path, lock: int | None, owner: int) -> None:
    if os.getpid() != owner:
        return  # a forked child: the folder is its parent's
    shutil.rmtree(path, ignore_errors=True)
    if lock is not None:
        os.close(lock)


#: Bytes of all kept products; beyond, the oldest are removed until half is left.
MAX_BYTES = 256 * 2**20


def user_cache() -> Path:
    """Return the folder of what is kept between runs; everything in it can be made again."""
    home = os.environ.get("XDG_CACHE_HOME", "") or os.environ.get("LOCALAPPDATA", "")
    return (Path(home) if home else Path.home() / ".cache") / "aero-bayes"


def make_once(name: str, ingredients: Iterable[bytes], make: Callable[[], bytes]) -> bytes:
    """Read a product that was made from the same ingredients before, or make it and keep it."""
    key = hashlib.sha256()
    for part in ingredients:
        key.update(len(part).to_bytes(8, "little"))
        key.update(part)
    stem, dot, suffix = name.partition(".")
    folder = user_cache() / "made"
    kept = folder / f"{stem}-{key.hexdigest()[:32]}{dot}{suffix}"
    with suppress(OSError):
        made = kept.read_bytes()
        os.utime(kept)  # used just now: it is removed last
        return made
    made = make()
    with suppress(OSError):  # no room to keep it, or no right: the next run makes it again
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(kept, made)
        _remove_oldest(folder)
    return made


def _remove_oldest(folder: Path) -> None:
    """Keep the folder below its size. Other runs may remove files at the same time."""
    files = []
    for entry in os.scandir(folder):
        with suppress(OSError):
            status = entry.stat()
            files.append((status.st_mtime_ns, status.st_size, entry.path))
    total = sum(size for _, size, _ in files)
    if total <= MAX_BYTES:
        return
    for _, size, path in sorted(files):
        with suppress(OSError):
            os.unlink(path)
        total -= size
        if total <= MAX_BYTES // 2:
            break
