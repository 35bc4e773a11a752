"""Run by :mod:`aero_bayes.data.matlab` in a process of its own: reads a MATLAB file and writes its vectors to stdout.

SciPy's and HDF5's readers are compiled code, which a damaged file can crash or make ask for any amount of memory.
Started as ``python matlab_process.py FILE MEMORY`` (bytes). It answers with a pickled dictionary: vectors by name, the
names of what cannot be read, whether it is a result of a simulation; or the error.
"""

from __future__ import annotations

import pickle
import sys
import warnings
from collections.abc import Mapping
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
HDF5 = b"\x89HDF\r\n\x1a\n"


def main(path: Path, memory: int) -> None:
    """Answer with the vectors, the names of what cannot be read, or what is wrong with the file."""
    with suppress(ImportError):  # Windows has no limits that a process sets itself
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        opaque: list[str] = []
        variables = _variables(path, opaque)
        vectors: dict[str, FloatArray] = {}
        result = {"dataInfo", "name", "data_2"} <= set(variables)
        if result:
            vectors = _trajectories(variables)
        else:
            for name, value in variables.items():
                _flatten(name, value, vectors)
        answer: dict[str, Any] = {"vectors": vectors, "opaque": opaque, "result": result}
    except MemoryError:
        answer = {"error": "needs more memory than is free"}
    except Exception as error:
        answer = {"error": f"{error}".partition("\n")[0] or type(error).__name__}
    pickle.dump(answer, sys.stdout.buffer)


def _variables(path: Path, opaque: list[str]) -> dict[str, Any]:
    """Return the file's variables as arrays and dictionaries; names of those that cannot be read go to ``opaque``."""
    with path.open("rb") as file:
        head = file.read(520)
    if head.startswith(HDF5) or head[512:520] == HDF5:
        import h5py

        with h5py.File(path, "r") as file:
            items = ((name, item) for name, item in file.items() if not name.startswith("#"))
            found = {name: _from_hdf5(name, item, file, opaque) for name, item in items}
        return found | _objects(path, opaque)
    from scipy.io import loadmat

    content = loadmat(path, simplify_cells=True)
    named = {name: value for name, value in content.items() if not name.startswith("__")}
    for name, value in list(named.items()):
        kind = value.dtype if isinstance(value, np.ndarray) else None
        if type(value).__name__ == "MatlabOpaque" or (kind is not None and kind.names and "s0" in kind.names):
            opaque.append(name)
            del named[name]
    if "__function_workspace__" in content and not named and not opaque:
        opaque.append("its variables")
    return named | _objects(path, opaque)


def _objects(path: Path, opaque: list[str]) -> dict[str, Any]:
    """Read tables, timetables and timeseries by mat-io, where it is installed; what it read leaves ``opaque``."""
    if not opaque:
        return {}
    try:
        from matio import load_from_mat
    except ImportError:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            content = load_from_mat(str(path))
        except Exception:
            return {}
    found = {name: fields for name, value in content.items() if (fields := _fields_of(value)) is not None}
    opaque[:] = [name for name in opaque if name not in found and not (found and name == "its variables")]
    return found


def _fields_of(value: Any) -> dict[str, Any] | None:
    """Return the columns of a table or timetable, or times and values of a timeseries; None for anything else."""
    if hasattr(value, "columns"):
        fields = {str(name): value[name].to_numpy() for name in value.columns}
        index = value.index
        if index.dtype.kind in "mM" and len(index):
            start = index[0] if index.dtype.kind == "M" else np.timedelta64(0, "ns")
            fields = {"time": np.asarray((index - start) / np.timedelta64(1, "s"), dtype=float)} | fields
        return fields
    properties = getattr(value, "properties", None)
    one = np.ravel(properties)[0] if isinstance(properties, np.ndarray) and properties.size == 1 else properties
    if not isinstance(one, Mapping) or "timeseries" not in str(getattr(value, "classname", "")):
        return None
    times = next((one[key] for key in ("Time_", "Time") if np.size(one.get(key, 0)) > 1), None)
    values = next((one[key] for key in ("Data_", "Data") if np.size(one.get(key, 0)) > 1), None)
    return None if times is None or values is None else {"time": np.ravel(times), "": np.squeeze(values)}


def _trajectories(variables: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Read variables over time of a result of Dymola or OpenModelica; of a time that is there twice (event), the last.

    ``dataInfo`` has a column for each name: the matrix with its values (0: the time, 1: constants, 2: over time), the
    row in it, negative for one that enters with the other sign. ``Aclass`` says in which order matrices are stored."""
    transposed = len(variables["Aclass"]) > 3 and str(variables["Aclass"][3]).startswith("binTrans")
    info, data = np.asarray(variables["dataInfo"]), np.atleast_2d(np.asarray(variables["data_2"], dtype=float))
    names = [str(name) for name in variables["name"]]
    if transposed:
        names = ["".join(letters) for letters in zip_longest(*names, fillvalue="")]
    else:
        info, data = info.T, data.T
    time = data[0]
    last = np.append(np.diff(time) != 0.0, True)
    found = {"time": np.ascontiguousarray(time[last])}
    for name, (matrix, row, *_) in zip((n.strip(" \0") for n in names), info.T, strict=False):
        if int(matrix) == 2 and abs(int(row)) > 1 and name:
            found[name] = np.ascontiguousarray(np.sign(row) * data[abs(int(row)) - 1][last])
    return found


def _from_hdf5(name: str, item: Any, file: Any, opaque: list[str]) -> Any:
    """Read what MATLAB stores: arrays transposed, text as numbers, cells and structure arrays as references."""
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
            _flatten(f"{name}.{key}" if key else name, child, vectors)
    elif isinstance(value, (list, np.ndarray)) and len(value) and isinstance(value[0], Mapping):
        for index, child in enumerate(value, start=1):
            _flatten(f"{name}({index})", child, vectors)
    elif isinstance(value, np.ndarray):
        _flatten_array(name, value, vectors)


def _signals(signals: Any) -> list[tuple[str, Any]]:
    """Return (label, values) of each signal, from a structure array in either file version."""
    if isinstance(signals, Mapping):
        values, labels = signals.get("values"), signals.get("label", "")
        if isinstance(values, list):
            names = labels if isinstance(labels, list) else [labels] * len(values)
            signals = [{"label": label, "values": own} for label, own in zip(names, values, strict=False)]
        else:
            signals = [signals]
    found = [one for one in signals if isinstance(one, Mapping)]
    return [(label.strip() if isinstance(label := one.get("label"), str) else "", one.get("values")) for one in found]


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


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
