"""The zip archive of an FMU, which may come from anywhere: checked before anything of it is written or believed."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from aero_bayes.errors import InputError

MAX_UNPACKED_BYTES = 1 << 30
MAX_TEXT_BYTES = 64 << 20
MAX_MEMBERS = 100_000
DESCRIPTION = "modelDescription.xml"

# What zipfile raises on archives that are damaged, encrypted or packed in a way it does not know.
_UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError, ValueError)


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except InputError:
        raise
    except _UNREADABLE as error:
        raise InputError(f"{path}: not a readable zip archive (expected an FMU): {error}") from error


def read_texts(path: Path, *optional: str) -> tuple[set[str], list[bytes]]:
    """Return the members' names of an FMU, its model description, and further members, empty where
    they are not there."""
    with _opened(path) as archive:
        names = _check_members(path, archive)
        if DESCRIPTION not in names:
            raise InputError(f"{path}: no {DESCRIPTION} inside, so this is not an FMU")
        for name in (DESCRIPTION, *optional):
            if name in names and archive.getinfo(name).file_size > MAX_TEXT_BYTES:
                raise InputError(f"{path}: {name} is larger than {MAX_TEXT_BYTES >> 20} MiB")
        return names, [archive.read(name) if name in names else b"" for name in (DESCRIPTION, *optional)]


def first_bytes(path: Path, name: str, count: int) -> bytes:
    """Return the beginning of a member."""
    with _opened(path) as archive, archive.open(name) as member:
        return member.read(count)


def extract(path: Path, folder: Path) -> None:
    """Unpack into an existing private folder; no member leaves it, and none is larger than it says."""
    with _opened(path) as archive:
        _check_members(path, archive)
        archive.extractall(folder)


def _check_members(path: Path, archive: zipfile.ZipFile) -> set[str]:
    members = archive.infolist()
    if len(members) > MAX_MEMBERS:
        raise InputError(f"{path}: has {len(members)} members (at most {MAX_MEMBERS} are allowed)")
    total, files, folders = 0, dict[str, zipfile.ZipInfo](), set[str]()
    twice = []
    for member in members:
        name = member.filename.replace("\\", "/")
        parts = PurePosixPath(name)
        if parts.is_absolute() or ".." in parts.parts or ":" in name.split("/")[0]:
            raise InputError(f"{path}: member {member.filename!r} would be unpacked outside its folder")
        kind = (member.external_attr >> 16) & 0o170000
        if kind == 0o120000:
            raise InputError(f"{path}: member {member.filename!r} is a symbolic link")
        if kind not in (0, 0o100000, 0o040000):
            raise InputError(f"{path}: member {member.filename!r} is neither a file nor a folder")
        folders.update(str(p) for p in parts.parents)
        if name.endswith("/"):
            folders.add(str(parts))
        elif str(parts) in files:
            twice.append((files[str(parts)], member))
        else:
            files[str(parts)] = member
        total += member.file_size
    both = sorted(files.keys() & folders)
    if both:
        raise InputError(f"{path}: member {both[0]!r} is a file and a folder")
    if total > MAX_UNPACKED_BYTES:
        raise InputError(f"{path}: unpacks to {total >> 20} MiB (at most {MAX_UNPACKED_BYTES >> 20} MiB are allowed)")
    for first, second in twice:
        if not _are_equal(archive, first, second):
            raise InputError(f"{path}: member {second.filename!r} is there twice, with different contents")
    return set(archive.namelist())


def _are_equal(archive: zipfile.ZipFile, first: zipfile.ZipInfo, second: zipfile.ZipInfo) -> bool:
    if (first.file_size, first.CRC) != (second.file_size, second.CRC):
        return False
    with archive.open(first) as a, archive.open(second) as b:
        while part := a.read(1 << 20):
            if part != b.read(len(part)):
                return False
    return True
