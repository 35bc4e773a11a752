"""Results of long work so far, in one file that is replaced as a whole, whenever the process dies.

A result is kept under a hash of what it depends on (memoisation). A run that is resumed asks for the same results in
the same order and gets most of them at once, so that it ends bit by bit as it would have without the interruption.
"""

from __future__ import annotations

import hashlib
import os
import time
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import InputError
from aero_bayes.files import whole_file

T = TypeVar("T")
Arrays = Mapping[str, NDArray[np.generic]]

#: Least time between two writes: in s, and as a multiple of the time that the last write took.
MIN_WRITE_INTERVAL, MIN_INTERVAL_RATIO = 1.0, 50.0


class ResultCache:
    """Results by the hash of what they depend on."""

    def __init__(self) -> None:
        self._results: dict[str, dict[str, NDArray[np.generic]]] = {}

    def get(self, key: str) -> Arrays | None:
        """Return the result under a key; None if there is none."""
        return self._results.get(key)

    def put(self, key: str, arrays: Arrays, *, now: bool = False) -> None:
        """Keep a result under a key; with ``now``, write it to disk at once if it is kept there."""
        self._results[key] = dict(arrays)

    def known(self) -> frozenset[str]:
        """Return the keys of all results so far."""
        return frozenset(self._results)

    def beyond(self, known: frozenset[str]) -> dict[str, Arrays]:
        """Return the results that are not among the known keys."""
        return {key: arrays for key, arrays in self._results.items() if key not in known}


class Checkpoint(ResultCache):
    """A result cache in a file, written by the process that opened it."""

    def __init__(self, path: Path, identity: str = "") -> None:
        super().__init__()
        self.path, self._identity, self._owner = path, identity, os.getpid()
        stored = _read_arrays(path)
        if stored is not None and str(stored.pop("identity", "")) != identity:
            raise InputError(
                f"{path} belongs to a run with other data, model or settings; without --resume the run starts again"
            )
        for name, values in (stored or {}).items():
            key, _, field = name.partition("/")
            self._results.setdefault(key, {})[field] = values
        self._next = time.monotonic() + MIN_WRITE_INTERVAL

    @classmethod
    def at(cls, place: Checkpoint | Path | str | None) -> Checkpoint | None:
        """Return the checkpoint in a file."""
        return cls(Path(place)) if isinstance(place, str | Path) else place

    def put(self, key: str, arrays: Arrays, *, now: bool = False) -> None:
        """Keep a result under a key; on disk at once, or before long."""
        super().put(key, arrays)
        began = time.monotonic()
        if os.getpid() != self._owner or (not now and began < self._next):
            return
        rows = {f"{key}/{field}": values for key, own in self._results.items() for field, values in own.items()}
        write_arrays(self.path, rows | {"identity": np.array(self._identity)})
        ended = time.monotonic()
        self._next = ended + max(MIN_WRITE_INTERVAL, MIN_INTERVAL_RATIO * (ended - began))


def digest(*items: object) -> str:
    """Hash of texts, numbers, arrays, mappings, sequences, and dataclasses of these."""
    found = hashlib.sha256()
    for item in items:
        if isinstance(item, np.ndarray):
            found.update(f"{item.dtype}{item.shape}".encode() + item.tobytes())
        elif is_dataclass(item) and not isinstance(item, type):
            found.update((type(item).__name__ + digest({f.name: getattr(item, f.name) for f in fields(item)})).encode())
        elif isinstance(item, Mapping):
            pairs = sorted(item.items(), key=lambda pair: repr(pair[0]))
            found.update(("mapping" + digest(*(part for pair in pairs for part in pair))).encode())
        elif isinstance(item, list | tuple):
            found.update(("sequence" + digest(*item)).encode())
        else:
            found.update(repr(item.item() if isinstance(item, np.generic) else item).encode())
        found.update(b"\0")
    return found.hexdigest()


def write_arrays(path: Path, arrays: Mapping[str, Any], *, compressed: bool = False) -> Path:
    """Write arrays to a file, whole or not at all; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary, temporary.open("wb") as file:
        if compressed:
            np.savez_compressed(file, allow_pickle=False, **arrays)
        else:
            np.savez(file, allow_pickle=False, **arrays)
    return path


def _read_arrays(path: Path) -> dict[str, NDArray[np.generic]] | None:
    """Return what :func:`write_arrays` wrote; None if there is no such file or it is no such file."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}
    except (FileNotFoundError, zipfile.BadZipFile, ValueError, OSError, KeyError):
        return None


def pack(item: Any, prefix: str) -> dict[str, NDArray[np.generic]]:
    """Unfold a dataclass of numbers, arrays and other such dataclasses into arrays; what is None is left out."""
    arrays: dict[str, NDArray[np.generic]] = {}
    for field in fields(item):
        value, name = getattr(item, field.name), prefix + field.name
        if is_dataclass(value):
            arrays |= pack(value, name + ".")
        elif value is not None:
            arrays[name] = np.asarray(value)
    return arrays


def unpack(kind: type[T], arrays: Arrays, prefix: str) -> T:
    """Return the dataclass that :func:`pack` took apart."""
    values: dict[str, Any] = {}
    for name, hint in get_type_hints(kind).items():
        inner = next((k for k in (hint, *get_args(hint)) if is_dataclass(k)), None)
        if isinstance(inner, type):
            known = any(key.startswith(f"{prefix}{name}.") for key in arrays)
            values[name] = unpack(inner, arrays, f"{prefix}{name}.") if known else None
        elif (value := arrays.get(prefix + name)) is not None:
            values[name] = value if value.ndim else value.item()
    return kind(**values)


def pack_random(random: np.random.RandomState) -> dict[str, NDArray[np.generic]]:
    """State of a Mersenne twister as arrays."""
    state: tuple[Any, ...] = random.get_state(legacy=True)  # type: ignore[assignment]
    return {"keys": np.asarray(state[1]), "rest": np.array([float(state[2]), float(state[3]), float(state[4])])}


def unpack_random(arrays: Arrays) -> tuple[str, NDArray[np.generic], int, int, float]:
    """Return the tuple that ``RandomState.set_state`` takes."""
    position, has_gauss, cached = (float(x) for x in arrays["rest"])
    return ("MT19937", arrays["keys"], int(position), int(has_gauss), cached)
