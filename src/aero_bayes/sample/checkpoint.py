"""A sampler's whole state in one file that is either the old one or the new one, whenever the process dies."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.files import whole_file


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


def pack_random(random: np.random.RandomState) -> dict[str, NDArray[np.generic]]:
    """State of a Mersenne twister as arrays."""
    state: tuple[Any, ...] = random.get_state(legacy=True)  # type: ignore[assignment]
    return {"keys": np.asarray(state[1]), "rest": np.array([float(state[2]), float(state[3]), float(state[4])])}


def unpack_random(arrays: Mapping[str, NDArray[np.generic]]) -> tuple[str, NDArray[np.generic], int, int, float]:
    """The tuple that ``RandomState.set_state`` takes."""
    position, has_gauss, cached = (float(x) for x in arrays["rest"])
    return ("MT19937", arrays["keys"], int(position), int(has_gauss), cached)
