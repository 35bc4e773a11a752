"""Tables that pandas reads whole: Excel, where the header may stand below a title, Parquet and Feather."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aero_bayes.data.find_table import longest_run, with_header
from aero_bayes.data.source import Cells, Source
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
#: Rows of a sheet in which its table is looked for.
MOST_ROWS = 200


def frame_source(path: Path) -> Source | None:
    """Return a table that pandas reads whole, as its suffix tells; None for another file.

    InputError for one that is known and not read, whose reader is not installed, or that cannot be read."""
    import pandas

    suffix = path.suffix.lower()
    if suffix in REFUSED:
        raise InputError(f"{path}: {suffix} is not read: {REFUSED[suffix]}")
    if suffix not in READERS:
        return None
    reader, extra = READERS[suffix]
    # Without its name pandas would ask the file for its engine first.
    options: dict[str, Any] = {"engine": "openpyxl", "header": None, "sheet_name": None} if extra == "excel" else {}
    try:
        frame = getattr(pandas, reader)(path, **options)
    except ImportError:
        raise missing_extra(path, extra) from None
    except Exception as error:
        reason = f"{error}".partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: cannot be read as a table: {reason}") from None
    first, where, note = 1, str(path), ""
    if extra == "excel":
        frame, first, where, note = _sheet(path, frame)
    elif frame.index.name is not None and frame.index.name not in frame.columns:
        frame = frame.reset_index()
    names = [str(column).strip() for column in frame.columns]

    def cells(asked: Sequence[str]) -> Cells:
        if not len(frame):
            raise InputError(f"{path}: holds a header but no data, expected one sample a row")
        columns = {name: frame.iloc[:, names.index(name)] for name in asked}
        return Cells(columns, lambda row: f"row {row + first}", first, note)

    return Source(path, names, cells, where, head=frame.head(20))


def _sheet(path: Path, sheets: dict[str, pandas.DataFrame]) -> tuple[pandas.DataFrame, int, str, str]:
    """Return the table of the first sheet that has one, its first row, where its names stand, and what is not read.

    Its columns are those with a name."""
    for title, sheet in sheets.items():
        rows = [list(map(_text, row)) for row in sheet.head(MOST_ROWS).to_numpy()]
        run = longest_run(rows)
        if not run.stop:
            continue
        found = with_header(rows, run, f"{path}, sheet {title}")
        stop = len(sheet)
        while stop > found.first and not found.goes_on(list(map(_text, sheet.iloc[stop - 1]))):
            stop -= 1
        below = [r for r in range(stop, len(sheet)) if sheet.iloc[r].notna().any()]
        data = sheet.iloc[found.first : stop, : len(found.names)].set_axis(found.names, axis=1)
        used = [k for k, name in enumerate(found.names) if name]
        where, note = f"{path}, sheet {title}, row {found.header[0] + 1}", f"{path.name}, sheet {title}"
        frame = data.iloc[:, used].reset_index(drop=True).infer_objects()
        return frame, found.first + 1, where, found.note(note, below)
    raise InputError(f"{path}: no sheet has a row of names above rows of numbers")


def missing_extra(path: Path, extra: str) -> InputError:
    """Return the error for a file whose reader is not installed."""
    return InputError(
        f"{path}: reading {path.suffix} files needs a further package: pip install 'aero-bayes[{extra}]', or write the "
        "signals as CSV"
    )


def _text(cell: Any) -> str:
    return "" if cell is None or cell != cell else str(cell).strip()
