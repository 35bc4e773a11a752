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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from aero_bayes.data.csv_text import FloatArray, free_memory
from aero_bayes.errors import InputError

HDF5 = b"\x89HDF\r\n\x1a\n"


def is_matlab(path: Path) -> bool:
    """Whether the file's content is that of a MATLAB file (its name does not matter)."""
    with path.open("rb") as file:
        head = file.read(520)
    return head.startswith((b"MATLAB ", HDF5)) or head[512:520] == HDF5


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
    vectors: dict[str, FloatArray] = {}
    opaque: list[str] = []
    for name, value in _variables(path, opaque).items():
        _flatten(name, value, vectors)
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
    vectors: dict[str, FloatArray] = {}
    for name, value in _variables(path, []).items():
        _flatten(name, value, vectors)
    return list(vectors)


def _variables(path: Path, opaque: list[str]) -> dict[str, Any]:
    """The file's variables as arrays and dictionaries; names of those that cannot be read go to ``opaque``."""
    with path.open("rb") as file:
        head = file.read(520)
    if head.startswith(HDF5) or head[512:520] == HDF5:
        return _variables_hdf5(path, opaque)
    try:
        content = loadmat(path, simplify_cells=True)
    except MemoryError:
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: not a readable MATLAB file ({reason})") from None
    named = {name: value for name, value in content.items() if not name.startswith("__")}
    for name, value in list(named.items()):
        kind = value.dtype if isinstance(value, np.ndarray) else None
        if type(value).__name__ == "MatlabOpaque" or (kind is not None and kind.names and "s0" in kind.names):
            opaque.append(name)
            del named[name]
    if "__function_workspace__" in content and not named and not opaque:
        opaque.append("its variables")
    return named


def _variables_hdf5(path: Path, opaque: list[str]) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise InputError(
            f"{path}: is a MATLAB 7.3 file, which needs h5py: pip install h5py (or save it with -v7)"
        ) from None
    try:
        with h5py.File(path, "r") as file:
            return {
                name: _from_hdf5(name, item, file, opaque) for name, item in file.items() if not name.startswith("#")
            }
    except OSError as error:
        raise InputError(f"{path}: not a readable MATLAB 7.3 file ({str(error).splitlines()[0]})") from None


def _from_hdf5(name: str, item: Any, file: Any, opaque: list[str]) -> Any:
    """MATLAB stores arrays transposed, text as numbers, and cells and structure arrays as references."""
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if hasattr(item, "keys"):
        return {key: _from_hdf5(f"{name}.{key}", child, file, opaque) for key, child in item.items()}
    if "MATLAB_object_decode" in item.attrs:
        opaque.append(name)
        return None
    if item.dtype.kind == "O":
        return [_from_hdf5(name, file[reference], file, opaque) for reference in np.ravel(item[()], order="F")]
    if item.attrs.get("MATLAB_empty", 0):
        return "" if kind == "char" else np.empty(0)
    if kind == "char":
        return "".join(chr(code) for code in np.ravel(item[()]))
    return np.asarray(item[()]).T


def _flatten(name: str, value: Any, vectors: dict[str, FloatArray]) -> None:
    """Add the vectors in ``value`` under the names of the module's table."""
    if isinstance(value, Mapping):
        fields = dict(value)
        if "signals" in fields and "time" in fields:
            for index, (label, values) in enumerate(_signals(fields.pop("signals")), start=1):
                _flatten_array(f"{name}.signals({index})", values, vectors)
                if label:
                    _flatten_array(f"{name}.{label}", values, vectors)
        for key, child in fields.items():
            _flatten(f"{name}.{key}", child, vectors)
    elif isinstance(value, (list, np.ndarray)) and len(value) and isinstance(value[0], Mapping):
        for index, child in enumerate(value, start=1):
            _flatten(f"{name}({index})", child, vectors)
    elif isinstance(value, np.ndarray):
        _flatten_array(name, value, vectors)


def _signals(signals: Any) -> list[tuple[str, Any]]:
    """(label, values) of each signal, from a structure array in either file version."""
    if isinstance(signals, Mapping):
        values, labels = signals.get("values"), signals.get("label", "")
        if isinstance(values, list):
            names = labels if isinstance(labels, list) else [labels] * len(values)
            return [(_text(label), value) for label, value in zip(names, values, strict=False)]
        signals = [signals]
    return [(_text(one.get("label")), one.get("values")) for one in signals if isinstance(one, Mapping)]


def _text(label: Any) -> str:
    return label.strip() if isinstance(label, str) else ""


def _flatten_array(name: str, value: Any, vectors: dict[str, FloatArray]) -> None:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf" or value.size < 2:
        return
    array = np.squeeze(value).astype(float)
    if array.ndim == 1:
        vectors[name] = np.ascontiguousarray(array)
    elif array.ndim == 2:
        signals = array if array.shape[0] <= array.shape[1] else array.T
        for index, row in enumerate(signals, start=1):
            vectors[f"{name}({index})"] = np.ascontiguousarray(row)
