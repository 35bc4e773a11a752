"""Logs that MATLAB, Simulink and QUARC write: version 5 through SciPy, version 7.3 (HDF5) through h5py.

Whatever the layout, a file becomes a flat set of named vectors, which a column mapping refers to:

===============================================  ==================================================================
in the file                                      names
===============================================  ==================================================================
vector ``x``                                     ``x``
matrix ``log`` of k signals (To File: a row      ``log(1)`` ... ``log(k)``, counted along the shorter side, so
each, time first; To Workspace: a column each)   ``log(1)`` is time
structure ``run`` with a field ``a``             ``run.a`` (and so on inwards)
Simulink's structure with time                   ``run.time``, ``run.signals(1)`` or its label ``run.label``; a signal
                                                 of several columns ``run.signals(1)(2)``
===============================================  ==================================================================

Only in a structure with time, or with a variable named ``t`` or ``tout``, is time found without a mapping.
``timeseries`` objects are an undocumented format; saving ``[ts.Time ts.Data]`` avoids it, and the error says so.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.data import matlab_process
from aero_bayes.data.csv_text import FloatArray, free_memory
from aero_bayes.data.matlab_process import HDF5
from aero_bayes.errors import InputError

#: Seconds that reading may take, and for each MiB of the file; the readers can be made to run for ever.
READ_TIME_LIMIT, READ_TIME_PER_MIB = 30.0, 0.5
#: Bytes of addresses that Python with NumPy and SciPy takes before it reads anything.
INTERPRETER_BYTES = 2 << 30


def is_matlab(path: Path) -> bool:
    """Whether the file's content is that of a MATLAB file (its name does not matter)."""
    with path.open("rb") as file:
        return file.read(7) == b"MATLAB " or _is_hdf5(path)


def _is_hdf5(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(520)
    return HDF5 in (head[:8], head[512:])


def read_matlab(
    path: Path,
    sources: Mapping[str, str],
    wanted: Sequence[str],
    optional: Sequence[str],
    memory: int | None = None,
) -> tuple[dict[str, FloatArray], str]:
    """Vectors of the file under the contract's names, and the file's hash.

    Parameters
    ----------
    path : Path
    sources : mapping of str to str
        The file's name (see above) of each of the contract's columns.
    wanted, optional : sequence of str
        Columns that must be there, and that are read where they are.
    memory : int, optional
        Bytes that may be used; what the machine has free by default.

    Raises
    ------
    InputError
        Too large for the memory, damaged, needs h5py, holds only timeseries objects, a column missing or of another
        length.
    """
    size, free = path.stat().st_size, memory if memory is not None else free_memory()
    # Read, flattened and converted: three copies; compressed files are seldom more than twice their size.
    if 6 * size > free:
        raise InputError(
            f"{path}: {size / 2**20:,.1f} MiB need about {6 * size / 2**20:,.0f} MiB of memory, "
            f"{free / 2**20:,.0f} MiB are free: write it as CSV, thin it, or run on a larger machine"
        )
    vectors, opaque = _read(path, free)
    sources = dict(sources)
    if sources["time"] not in vectors:
        times = [name for name in vectors if name.endswith(".time")] or [n for n in ("t", "tout") if n in vectors]
        if len(times) == 1:
            sources["time"] = times[0]
    for name in [*wanted, *optional]:
        labelled = [key for key in vectors if key.endswith(f".{sources[name]}")]
        if sources[name] not in vectors and len(labelled) == 1:
            sources[name] = labelled[0]
    found: dict[str, FloatArray] = {}
    shown = ", ".join(list(vectors)[:20]) or "nothing"
    for name in [*wanted, *optional]:
        if sources[name] in vectors:
            found[name] = vectors[sources[name]]
        elif name in wanted:
            hint = (
                f"; {', '.join(opaque)} cannot be read (timeseries or other object: save [ts.Time ts.Data] instead)"
                if opaque
                else "; map it with columns in the configuration"
            )
            raise InputError(f"{path}: no column {sources[name]}, found {shown}{hint}")
    length = found["time"].size
    for name, values in found.items():
        if values.size != length:
            raise InputError(f"{path}, column {name}: {values.size} values, expected {length} as in time")
    with path.open("rb") as file:
        return found, hashlib.file_digest(file, "sha256").hexdigest()


def matlab_names(path: Path) -> list[str]:
    """Names of the vectors in the file."""
    return list(_read(path, free_memory())[0])


def _read(path: Path, memory: int) -> tuple[dict[str, FloatArray], list[str]]:
    """The file's vectors and the names of what cannot be read, by a process that a damaged file may crash."""
    if _is_hdf5(path) and importlib.util.find_spec("h5py") is None:
        raise InputError(f"{path}: is a MATLAB 7.3 file, which needs h5py: pip install h5py (or save it with -v7)")
    # -P: files beside the reader are no modules
    command = [sys.executable, "-P", matlab_process.__file__, str(path), str(memory + INTERPRETER_BYTES)]
    limit = READ_TIME_LIMIT + READ_TIME_PER_MIB * path.stat().st_size / 2**20
    try:
        done = subprocess.run(
            command, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}, capture_output=True, check=False, timeout=limit
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: not a readable MATLAB file (not read within {limit:.0f} s)") from None
    line, _, data = done.stdout.partition(b"\n")
    answer: dict[str, Any] = json.loads(line) if done.returncode == 0 else {"error": "damaged: its reader crashed"}
    if "error" in answer:
        raise InputError(f"{path}: not a readable MATLAB file ({answer['error']})")
    sizes: dict[str, int] = answer["sizes"]
    parts = np.split(np.frombuffer(data), np.cumsum(list(sizes.values()))[:-1]) if sizes else []
    return dict(zip(sizes, parts, strict=True)), list(answer["opaque"])
