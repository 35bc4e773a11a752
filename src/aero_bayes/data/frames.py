"""Tables that pandas reads: Excel, where the header may stand below a title, Parquet and Feather."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aero_bayes.data.cells import is_number
from aero_bayes.data.csv_text import with_units
from aero_bayes.data.table import FileTable
from aero_bayes.errors import InputError

if TYPE_CHECKING:
    import pandas

#: Function of pandas that reads a file by its suffix, and the part of an installation that it needs.
READERS = {
    ".xlsx": ("read_excel", "excel"),
    ".xlsm": ("read_excel", "excel"),
    ".parquet": ("read_parquet", "parquet"),
    ".feather": ("read_feather", "parquet"),
}
#: Suffixes of tables that are not read, and what to do instead.
REFUSED = {
    ".xls": "save it as .xlsx or CSV",
    ".ods": "save it as .xlsx or CSV",
    ".pkl": "write it as CSV or Parquet",
}
#: Rows of a sheet in which its header is looked for.
MOST_TITLES = 60


def is_table(path: Path) -> bool:
    """Return whether a file is a table that pandas reads, by its suffix.

    InputError for one that is known and not read."""
    suffix = path.suffix.lower()
    if suffix in REFUSED:
        raise InputError(f"{path}: {suffix} is not read: {REFUSED[suffix]}")
    return suffix in READERS


class FrameTable:
    """A table that pandas reads whole; InputError if its reader is not installed, or cannot read the file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        name, extra = READERS[path.suffix.lower()]
        # Without its name pandas would ask the file for its engine first.
        options = {"engine": "openpyxl", "header": None, "sheet_name": None} if extra == "excel" else {}
        frame = _read_with_extra(path, extra, name, **options)
        self.first_row, self.where = 1, str(path)
        if extra == "excel":
            frame = self._sheet(frame)
        elif frame.index.name is not None and frame.index.name not in frame.columns:
            frame = frame.reset_index()
        self.names = [str(column).strip() for column in frame.columns]
        self._frame = frame.set_axis(range(len(self.names)), axis=1)

    def head(self) -> pandas.DataFrame:
        """Return the first rows."""
        return self._frame.head(20)

    def read(self, columns: Sequence[str], memory: int | None = None) -> FileTable:
        """Read columns by name."""
        found = self._frame[[self.names.index(name) for name in columns]].set_axis(list(columns), axis=1)
        if not len(found):
            raise InputError(f"{self.path}: holds a header but no data, expected one sample a row")
        digest, first = hashlib.sha256(self.path.read_bytes()).hexdigest(), self.first_row
        return FileTable(found, digest, lambda row: f"row {row + first}", first)

    def _sheet(self, sheets: dict[str, pandas.DataFrame]) -> pandas.DataFrame:
        """Return the first sheet with a header: a row of names above a row with numbers, or above one of units."""
        for title, sheet in sheets.items():
            for row in range(min(MOST_TITLES, len(sheet) - 1)):
                below = 1 if _has_numbers(sheet.iloc[row + 1]) else 2
                units = sheet.iloc[row + 1]
                if not _are_names(sheet.iloc[row]) or row + below >= len(sheet):
                    continue
                if below == 2 and not (_are_names(units, least=1) and _has_numbers(sheet.iloc[row + 2])):
                    continue
                used = [k for k, cell in enumerate(sheet.iloc[row]) if isinstance(cell, str) and cell.strip()]
                names = [str(sheet.iloc[row, k]).strip() for k in used]
                if below == 2:
                    names = with_units(names, ["" if _empty(units.iloc[k]) else str(units.iloc[k]) for k in used])
                data = sheet.iloc[row + below :, used].set_axis(names, axis=1).reset_index(drop=True)
                self.first_row, self.where = row + below + 1, f"{self.path}, sheet {title}, row {row + 1}"
                while len(data) and all(_empty(cell) for cell in data.iloc[-1]):
                    data = data.iloc[:-1]
                return data.infer_objects()
        raise InputError(f"{self.path}: no sheet has a row of names above rows of numbers")


def _read_with_extra(path: Path, extra: str, reader: str, **options: Any) -> Any:
    """Return what a reader of pandas makes of a file; InputError that names the extra where it needs one."""
    import pandas

    try:
        return getattr(pandas, reader)(path, **options)
    except ImportError:
        raise missing_extra(path, extra) from None
    except Exception as error:
        reason = f"{error}".partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: cannot be read as a table: {reason}") from None


def missing_extra(path: Path, extra: str) -> InputError:
    """Return the error for a file whose reader is not installed."""
    return InputError(
        f"{path}: reading {path.suffix} files needs a further package: pip install 'aero-bayes[{extra}]', or write the "
        "signals as CSV"
    )


def _empty(cell: Any) -> bool:
    return cell is None or (isinstance(cell, float) and np.isnan(cell)) or (isinstance(cell, str) and not cell.strip())


def _are_names(row: pandas.Series, least: int = 2) -> bool:
    given = [cell for cell in row if not _empty(cell)]
    return len(given) >= least and all(isinstance(cell, str) and not is_number(cell.strip()) for cell in given)


def _has_numbers(row: pandas.Series) -> bool:
    return any(not _empty(cell) and (not isinstance(cell, str) or is_number(cell.strip())) for cell in row)
