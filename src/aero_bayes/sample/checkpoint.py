"""A sampler's whole state in one file that is either the old one or the new one, whenever the process dies."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from aero_bayes.files import whole_file

T = TypeVar("T")


def write_arrays(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Write arrays to a temporary file beside ``path``, force it to disk, and rename it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
        file.flush()
        os.fsync(file.fileno())


def read_arrays(path: Path) -> dict[str, NDArray[np.generic]] | None:
    """What :func:`write_arrays` wrote; None if there is no such file or it is no such file."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}
    except (FileNotFoundError, zipfile.BadZipFile, ValueError, OSError, KeyError):
        return None


def pack(item: Any, prefix: str) -> dict[str, NDArray[np.generic]]:
    """Fields of a dataclass of numbers, arrays and other such dataclasses, as arrays; what is None is left out."""
    arrays: dict[str, NDArray[np.generic]] = {}
    for field in fields(item):
        value, name = getattr(item, field.name), prefix + field.name
        if is_dataclass(value):
            arrays |= pack(value, name + ".")
        elif value is not None:
            arrays[name] = np.asarray(value)
    return arrays


def unpack(kind: type[T], arrays: Mapping[str, NDArray[np.generic]], prefix: str) -> T:
    """The dataclass that :func:`pack` took apart."""
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


def unpack_random(arrays: Mapping[str, NDArray[np.generic]]) -> tuple[str, NDArray[np.generic], int, int, float]:
    """The tuple that ``RandomState.set_state`` takes."""
    position, has_gauss, cached = (float(x) for x in arrays["rest"])
    return ("MT19937", arrays["keys"], int(position), int(has_gauss), cached)
