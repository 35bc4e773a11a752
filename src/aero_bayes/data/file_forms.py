"""The forms of files that recordings are read from, told apart by content, or by suffix where that is not enough."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from aero_bayes.data import logs, matlab, modelica_table
from aero_bayes.data.frames import FrameTable, is_table
from aero_bayes.data.signals import Columns, Request
from aero_bayes.data.table import TableFile, read_table, row_names
from aero_bayes.data.text_table import TextTable
from aero_bayes.errors import InputError


class SignalFiles(Protocol):
    """A module that reads files of named vectors."""

    def is_one(self, path: Path) -> bool: ...

    def names_of(self, path: Path) -> list[str]: ...

    def read(self, path: Path, request: Request) -> Columns: ...


#: Suffixes of the files of a folder that are looked at.
SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".mat", ".xlsx", ".parquet", ".feather", ".mf4", ".tdms", ".lvm")
#: The modules that do.
SIGNAL_FILES: tuple[SignalFiles, ...] = (matlab, logs, modelica_table)


def read_columns(path: Path, request: Request) -> Columns:
    """Return the columns that a recording asks for, whatever the form of the file."""
    try:
        for form in SIGNAL_FILES:
            if form.is_one(path):
                return form.read(path, request)
        return read_table(_table(path), request)
    except PermissionError:
        raise InputError(f"{path}: may not be read (permission denied)") from None


def data_files(folder: Path) -> list[Path]:
    """Return the files of a folder that may hold data, by their suffix."""
    return [p for p in sorted(folder.iterdir()) if p.is_file() and p.suffix.lower() in SUFFIXES]


def column_names(path: Path) -> list[str]:
    """Return names of the columns or signals of a file, or of all files of a folder."""
    if path.is_dir():
        return list(dict.fromkeys(name for file in data_files(path) for name in column_names(file)))
    for form in SIGNAL_FILES:
        if form.is_one(path):
            return form.names_of(path)
    return row_names(_table(path))


def _table(path: Path) -> TableFile:
    return FrameTable(path) if is_table(path) else TextTable(path)
