"""Reading a recording from a file, and writing one."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.cells import plain_seconds
from aero_bayes.data.checks import check_recording
from aero_bayes.data.clock import with_steady_clock
from aero_bayes.data.file_forms import column_names, read_columns
from aero_bayes.data.layout import ColumnMap, Layout
from aero_bayes.data.recording import Recording
from aero_bayes.data.screen import hide
from aero_bayes.data.signals import Columns, Request, without_repeats
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
        A table of text with a header, a ``.mat`` file of MATLAB, Simulink, Dymola or OpenModelica, a table in Excel or
        Parquet, a log in MDF 4, TDMS or ``.lvm``, or a table of Modelica, told apart by content. An empty cell (NaN in
        MATLAB) of an output is a gap; the text ``nan`` is an error.
    columns : mapping of str to ColumnMap, optional
        Where a column of the layout is found if not under its own name and in SI.
    layout : Layout, optional
        Which columns there are; by default those that the package of the default model declares. Other columns of the
        file are not read.
    memory : int, optional
        Bytes that may be used; what is free by default.

    Returns
    -------
    Recording

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
    file, maps = Path(path), dict(columns or {})
    given = _read(file, maps, layout, memory)
    values = {name: _in_unit(column, name, maps, given.named, layout) for name, column in given.columns.items()}
    recording = Recording(
        name=file.stem,
        time=values["time"],
        inputs={name: np.full(values["time"].size, value) for name, value in layout.constants.items()}
        | {quantity.name: values[quantity.name] for quantity in layout.inputs},
        outputs={quantity.name: values[quantity.name] for quantity in layout.outputs if quantity.name in values},
        units={name: unit for name, unit in layout.units.items() if name in values},
        sha256=given.sha256,
        path=file,
        first_row=given.first_row,
    )
    recording = with_steady_clock(recording)
    for name, rows in given.bad.items():
        what = f"{int(rows.sum())} readings of {name} are marked as bad by the column of its quality."
        recording = hide(recording, name, rows, "quality", what)
    check_recording(recording, layout, given.line)
    return recording


def _read(file: Path, maps: Mapping[str, ColumnMap], layout: Layout, memory: int | None) -> Columns:
    """Read the columns of a layout, in their own units; the time in seconds where no unit is given."""
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
    held = [quantity.name for quantity in layout.inputs]
    outputs = [quantity.name for quantity in layout.outputs]
    wanted = ["time", *held, *(name for name in outputs if name in maps)]
    optional = [name for name in outputs if name not in maps]
    given = _after_events(read_columns(file, Request(sources, wanted, optional, held, memory)), held)
    if not any(name in given.columns for name in outputs):
        missing = ", ".join(sources[name] for name in outputs)
        there = known_names_hint(sources[outputs[0]] if outputs else "", column_names(file))
        raise InputError(f"{file}: no output column, expected at least one of {missing}{there}")
    if maps.get("time", ColumnMap("time")).unit is None:
        given.columns["time"] = plain_seconds(given.columns["time"])
    return given


def _after_events(given: Columns, held: Sequence[str]) -> Columns:
    """Return the rows without those that a simulator writes a second time at an event."""
    keep = without_repeats(given.columns, held)
    if keep.all():
        return given
    rows = np.flatnonzero(keep)
    return replace(
        given,
        columns={name: values[keep] for name, values in given.columns.items()},
        bad={name: marked[keep] for name, marked in given.bad.items()},
        line=lambda row: given.line(int(rows[row])),
    )


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


def _in_unit(
    values: FloatArray, name: str, maps: Mapping[str, ColumnMap], named: Mapping[str, str], layout: Layout
) -> FloatArray:
    """Convert values to the unit of the layout, from the unit that was given or the one in the column's name."""
    column = maps.get(name, ColumnMap(name))
    called = re.fullmatch(r".*? \[(.*)\]", named.get(name, ""))
    if column.unit is None and called and named[name] != column.source:
        column = replace(column, unit=called[1])
    return column.convert(values, name, layout.units[name])
