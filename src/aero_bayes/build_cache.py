"""Products of compilers, kept between runs under a key of what they were made from."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from aero_bayes.files import write_whole

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
