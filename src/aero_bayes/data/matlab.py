"""Logs that MATLAB, Simulink, QUARC, Dymola and OpenModelica write: ``.mat`` files of versions 4, 5 and 7.3.

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

table or timetable ``run``                       ``run.u``; the times of a timetable are ``run.time``
timeseries ``y``                                 ``y`` and ``y.time``
result of Dymola or OpenModelica                 as in the model, ``time`` first; at an event the values after it
===============================================  ==================================================================

In structures with time, timetables and timeseries, and with a variable named ``t`` or ``tout``, time is found without
a mapping; signals that have times of their own are brought to common ones. Tables, timetables and timeseries are
objects, which the package mat-io reads (``aero-bayes[matlab]``).
"""

from __future__ import annotations

import importlib.util
import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from aero_bayes.data import matlab_process
from aero_bayes.data.matlab_process import HDF5, FloatArray
from aero_bayes.data.table import MAP_COLUMNS, Table
from aero_bayes.data.tables import free_memory
from aero_bayes.errors import InputError

#: Seconds that reading may take, and for each MiB of the file; the readers can be made to run for ever.
READ_TIME_LIMIT, READ_TIME_PER_MIB = 30.0, 0.5
#: Bytes of addresses that Python with NumPy and SciPy takes before it reads anything.
INTERPRETER_BYTES = 2 << 30


def matlab_table(path: Path) -> Table | None:
    """Return the vectors of the file, and in the hint what of it cannot be read; None if its content is not MATLAB's.

    Its name matters for version 4 only, which has no mark."""
    with path.open("rb") as file:
        head = file.read(520)
    is_hdf5, binary = HDF5 in (head[:8], head[512:]), not head[:7].isascii() or b"\0" in head[:7]
    if not (head.startswith(b"MATLAB ") or is_hdf5 or (path.suffix.lower() == ".mat" and binary)):
        return None
    size, free = path.stat().st_size, free_memory()
    # Read, flattened and converted: three copies; compressed files are seldom more than twice their size.
    if 6 * size > free:
        raise InputError(
            f"{path}: {size / 2**20:,.1f} MiB need about {6 * size / 2**20:,.0f} MiB of memory, "
            f"{free / 2**20:,.0f} MiB are free: write it as CSV, thin it, or run on a larger machine"
        )
    answer = _read(path, free)
    vectors: dict[str, FloatArray] = answer["vectors"]
    clocks = dict.fromkeys(list(vectors)[1:], "time") if answer["result"] else _clocks(list(vectors))
    hint = f"; {_not_read(answer['opaque'])}" if answer["opaque"] else MAP_COLUMNS
    return Table.of_vectors(path, vectors, clocks, hint)


def _not_read(opaque: Sequence[str]) -> str:
    """Return which objects of MATLAB were not read, and what to do about them; SciPy knows no names of some."""
    named = ", ".join(name for name in opaque if name != "None") or "an object"
    if importlib.util.find_spec("matio") is None:
        return f"{named} cannot be read: pip install 'aero-bayes[matlab]' reads tables, timetables and timeseries"
    return (
        f"{named} cannot be read, being no table, timetable or timeseries; of a Simulink Dataset save the elements: "
        'u = logsout.get("u").Values'
    )


def _clocks(names: Sequence[str]) -> dict[str, str]:
    """Return the times of each vector: those of its structure, else the only ones that the file has."""
    times = [n for n in names if n.rpartition(".")[2].casefold() == "time"]
    common = [n for n in ("time", "t", "tout") if n in names] or (times if len(times) == 1 else [])
    clocks = {}
    for name in names:
        own = [t for t in times if "." in t and (name == t[:-5] or name.startswith((t[:-4], f"{t[:-5]}(")))]
        clock = max(own, key=len, default=common[0] if common else "")
        if clock not in ("", name):
            clocks[name] = clock
    return clocks


def _read(path: Path, memory: int) -> dict[str, Any]:
    """Return what :mod:`matlab_process` answers, which a damaged file may crash."""
    # -P: files beside the reader are no modules
    command = [sys.executable, "-P", matlab_process.__file__, str(path), str(memory + INTERPRETER_BYTES)]
    limit = READ_TIME_LIMIT + READ_TIME_PER_MIB * path.stat().st_size / 2**20
    try:
        done = subprocess.run(
            command, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}, capture_output=True, check=False, timeout=limit
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: not a readable MATLAB file (not read within {limit:.0f} s)") from None
    answer: dict[str, Any] = {"error": "damaged: its reader crashed"}
    if done.returncode == 0:
        answer = pickle.loads(done.stdout)
    if "error" in answer:
        raise InputError(f"{path}: not a readable MATLAB file ({answer['error']})")
    return answer
