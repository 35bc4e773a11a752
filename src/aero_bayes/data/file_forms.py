"""The forms of files that recordings are read from, told apart by content, or by suffix where that is not enough."""

from __future__ import annotations

from pathlib import Path

from aero_bayes.data import logs, matlab, modelica_table
from aero_bayes.data.frames import FrameTable, is_table
from aero_bayes.data.signals import Columns, Request, Signals, pick_signals
from aero_bayes.data.table import TableFile, read_table, row_names
from aero_bayes.data.text_table import TextTable
from aero_bayes.errors import InputError

#: Suffixes of the files of a folder that are looked at.
SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".mat", ".xlsx", ".parquet", ".feather", ".mf4", ".tdms", ".lvm")
#: Whether a file is of a form of named vectors, and what reads them.
SIGNAL_FILES = tuple((form.is_one, form.signals_in) for form in (matlab, logs, modelica_table))


def read_columns(path: Path, request: Request) -> Columns:
    """Return the columns that a recording asks for, whatever the form of the file."""
    try:
        signals = _signals(path, request.memory)
        return read_table(_table(path), request) if signals is None else pick_signals(path, signals, request)
    except PermissionError:
        raise InputError(f"{path}: may not be read (permission denied)") from None


def data_files(folder: Path) -> list[Path]:
    """Return the files of a folder that may hold data, by their suffix."""
    return [p for p in sorted(folder.iterdir()) if p.is_file() and p.suffix.lower() in SUFFIXES]


def column_names(path: Path) -> list[str]:
    """Return names of the columns or signals of a file, or of all files of a folder."""
    if path.is_dir():
        return list(dict.fromkeys(name for file in data_files(path) for name in column_names(file)))
    signals = _signals(path)
    if signals is not None and not signals.vectors:
        raise InputError(f"{path}: holds no signal over time{signals.hint}")
    return row_names(_table(path)) if signals is None else list(signals.vectors)


def _signals(path: Path, memory: int | None = None) -> Signals | None:
    """Return the vectors of a file that holds named vectors; None for a table."""
    return next((signals_in(path, memory) for is_one, signals_in in SIGNAL_FILES if is_one(path)), None)


def _table(path: Path) -> TableFile:
    return FrameTable(path) if is_table(path) else TextTable(path)
