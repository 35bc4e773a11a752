"""Reading a recording from a file, and writing one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data.checks import check_recording
from aero_bayes.data.csv_forms import plain_seconds, quality_columns
from aero_bayes.data.csv_text import CsvTable, FloatArray, read_columns, read_header, read_quality
from aero_bayes.data.frames import frame_columns, is_table, read_frame
from aero_bayes.data.layout import ColumnMap, Layout
from aero_bayes.data.matlab import is_matlab, matlab_names, read_matlab
from aero_bayes.data.recording import Recording
from aero_bayes.data.screen import hide
from aero_bayes.default_model import DEFAULT_MODEL
from aero_bayes.errors import InputError
from aero_bayes.export.library import declaration_of
from aero_bayes.files import whole_file
from aero_bayes.unknown_names import known_names_hint


def read_recording(
    path: Path | str,
    columns: Mapping[str, ColumnMap] | None = None,
    *,
    layout: Layout | None = None,
    memory: int | None = None,
) -> Recording:
    """Read and check a recording.

    Parameters
    ----------
    path : path
        A CSV file with a header, or a MATLAB ``.mat`` file (version 5, or 7.3 where h5py is installed), told apart by
        content; or a table in Excel (``.xlsx``) or Parquet, where pandas has its reader installed. An empty cell (NaN
        in MATLAB) of an output is a gap; the text ``nan`` is an error.
    columns : mapping of str to ColumnMap, optional
        Where a column of the layout is found if not under its own name and in SI.
    layout : Layout, optional
        Which columns there are; by default those that the package of the default model declares. Other columns of the
        file are not read.
    memory : int, optional
        Bytes that may be used; what is free by default.

    Raises
    ------
    InputError
        One line that names file, row (the line of a CSV file, the header being 1; the sample of a MATLAB file), column
        and what was expected.

    Examples
    --------
    >>> layout = Layout.of(["F"], ["position"])
    >>> aero_bayes.read_recording("train.csv", layout=layout)
    <Recording train: F -> position; 2001 rows, 40 s at 50 Hz>
    """
    layout = layout or Layout.declared(declaration_of(DEFAULT_MODEL))
    file = Path(path)
    maps = dict(columns or {})
    for column in maps:
        if column not in layout.units:
            raise InputError(
                f"columns: {column} is not a column of the model, expected one of {', '.join(layout.units)}"
            )
    if not file.exists():
        raise InputError(f"{file}: no such file")
    if not file.is_file():
        raise InputError(f"{file}: is not a file")
    sources = {name: maps[name].source if name in maps else name for name in layout.units}
    wanted = ["time", *(quantity.name for quantity in layout.inputs)]
    wanted += [quantity.name for quantity in layout.outputs if quantity.name in maps]
    optional = [quantity.name for quantity in layout.outputs if quantity.name not in maps]
    where: Callable[[int], str] = _sample
    first_row, bad = 1, dict[str, NDArray[np.bool_]]()
    try:
        if is_table(file):
            needed = list(dict.fromkeys(sources[name] for name in wanted))
            columns_of_file, sha256 = frame_columns(file, sources["time"], needed, [sources[name] for name in optional])
            found = {n: columns_of_file[source] for n, source in sources.items() if source in columns_of_file}
            first_row = 2
        elif is_matlab(file):
            found, sha256 = read_matlab(file, sources, wanted, optional, memory)
        else:
            table = read_columns(
                file,
                list(dict.fromkeys(sources[name] for name in wanted)),
                [sources[name] for name in optional],
                memory,
            )
            found = {name: table.columns[source] for name, source in sources.items() if source in table.columns}
            sha256, line, first_row = table.sha256, table.line, table.line(0)
            bad = _bad_readings(file, sources, layout, table)

            def where(row: int) -> str:
                return f"row {line(row)}"
    except PermissionError:
        raise InputError(f"{file}: may not be read (permission denied)") from None
    if not any(quantity.name in found for quantity in layout.outputs):
        missing = ", ".join(sources[quantity.name] for quantity in layout.outputs)
        there = known_names_hint(
            next(iter(sources[quantity.name] for quantity in layout.outputs), ""), column_names(file)
        )
        raise InputError(f"{file}: no output column, expected at least one of {missing}{there}")
    if maps.get("time", ColumnMap("time")).unit is None:
        found["time"] = plain_seconds(found["time"])
    values = {name: _in_unit(column, name, maps.get(name), layout) for name, column in found.items()}
    recording = Recording(
        name=file.stem,
        time=values["time"],
        inputs={name: np.full(values["time"].size, value) for name, value in layout.constants.items()}
        | {quantity.name: values[quantity.name] for quantity in layout.inputs},
        outputs={quantity.name: values[quantity.name] for quantity in layout.outputs if quantity.name in values},
        units={name: unit for name, unit in layout.units.items() if name in values},
        sha256=sha256,
        path=file,
        first_row=first_row,
    )
    for name, rows in bad.items():
        what = f"{int(rows.sum())} readings of {name} are marked as bad by the column of its quality."
        recording = hide(recording, name, rows, "quality", what)
    check_recording(recording, layout, where)
    return recording


def _bad_readings(
    file: Path, sources: Mapping[str, str], layout: Layout, table: CsvTable
) -> dict[str, NDArray[np.bool_]]:
    """Rows of outputs that a column of quality words calls bad, by output."""
    outputs = {q.name: sources[q.name] for q in layout.outputs if sources[q.name] in table.columns}
    bad: dict[str, NDArray[np.bool_]] = {}
    for column, signals in quality_columns(read_header(file).names, outputs).items():
        rows = read_quality(file, column, next(iter(table.columns.values())).size)
        bad |= {signal: bad.get(signal, rows) | rows for signal in signals if rows.any()}
    return bad


def column_names(path: Path) -> list[str]:
    """Names of the columns of a file, or of the variables of a MATLAB file."""
    if is_table(path):
        return list(read_frame(path).columns)
    return matlab_names(path) if is_matlab(path) else read_header(path).names


def write_csv(recording: Recording, path: Path | str) -> Path:
    """Write a recording so that :func:`read_recording` returns the same numbers; gaps become empty cells.

    Parameters
    ----------
    recording : Recording
    path : path
        The file; it appears whole or not at all.

    Examples
    --------
    >>> from aero_bayes.data import write_csv
    >>> write_csv(recording.slice(0.0, 10.0), "part.csv").name
    'part.csv'
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    columns = {"time": recording.time, **recording.inputs, **recording.outputs}
    with whole_file(target) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(columns) + "\n")
        for row in np.column_stack(list(columns.values())).tolist():
            file.write(",".join("" if value != value else repr(value) for value in row) + "\n")
    return target


def _sample(row: int) -> str:
    return f"sample {row + 1}"


def _in_unit(values: FloatArray, name: str, column: ColumnMap | None, layout: Layout) -> FloatArray:
    return values if column is None else column.convert(values, name, layout.units[name])
