"""Tables: of text, in Excel where the header may stand below a title, in Parquet and Feather.

Columns of text are separated by commas, by semicolons or tabs, where a comma is a decimal mark, or by spaces. A line
inside the table that has not as many cells as the others is refused with its number. Pandas reads the cells; what they
say is decided in :mod:`aero_bayes.data.cells`.
"""

from __future__ import annotations

import codecs
import csv
import re
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

import numpy as np

from aero_bayes.data.cells import DATE, NO_READING, NUMBER, measured
from aero_bayes.data.find_table import COMMENTS, longest_run, told_width, with_header
from aero_bayes.data.table import HEAD, Table
from aero_bayes.errors import InputError

if TYPE_CHECKING:
    import pandas

Read = TypeVar("Read")
SEPARATORS = (",", ";", "\t", " ")
#: Lines in which a table is looked for, the second number if it is not in the first.
HEAD_LINES = (200, 5000)
#: Characters that a line may have.
MAX_LINE = 8 << 20
#: A thousands' point before a decimal comma, in a file whose decimal mark is a comma.
POINT_AND_COMMA = re.compile(r"\d\.\d{3},\d")
#: Version of pandas that reads every number exactly without being asked.
EXACT_SINCE = (3, 1)
#: Bytes that pandas takes for a value while it reads, and for anything at all.
BYTES_PER_VALUE, LEAST_BYTES = 24, 64 << 20
#: Most lines of totals that may end a table.
MOST_TOTALS = 50


class TextFile:
    """A table of text. Columns are read when they are asked for, if the memory is enough."""

    def __init__(self, path: Path) -> None:
        import pandas

        self.path, self._encoding = path, _encoding(path)
        for most in HEAD_LINES:
            with self._open() as file:
                lines = list(islice(_lines(file, path), most))
            found = {s: [_cells(line, s) for line in lines] for s in SEPARATORS}
            runs = {s: longest_run(rows) for s, rows in found.items()}
            self._separator = max(SEPARATORS, key=lambda s: runs[s].values)
            rows, run = found[self._separator], runs[self._separator]
            if run.stop and run.stop > min(most, len(lines)) // 4:
                break
        if not run.stop:
            raise InputError(f"{path}: holds no table: expected names, and rows of numbers below them")
        self._found, self._width = with_header(rows, run, str(path)), run.width
        names = self._found.names
        head = [row[: len(names)] for row in rows[self._found.first :] if len(row) == run.width][:HEAD]
        where = f"{path}, row {self._found.header[0] + 1}"
        columns = {name: pandas.Series([row[k] for row in head]) for k, name in enumerate(names)}
        self.table = Table(path, names, columns, where, "row", more=self._read)

    def _read(self, columns: Sequence[str]) -> Table:
        """Read columns by name; InputError for lines with too few or too many cells, and for too little memory."""
        blanks, count, below, marks = self._scan()
        needed = BYTES_PER_VALUE * count * len(columns) + LEAST_BYTES
        if needed > (free := free_memory()):
            raise InputError(
                f"{self.path}: {count:,} rows of {len(columns)} columns need {needed / 2**20:,.0f} MiB of memory, "
                f"{free / 2**20:,.0f} MiB are free: thin or cut the file, or run on a larger machine"
            )
        places = [self.table.names.index(name) for name in columns]
        first = self._found.first + 1
        lines = np.setdiff1d(np.arange(first, first + count + len(blanks)), blanks)[:count]
        frame = self._frame(places, count, marks).set_axis(lines, axis=0)
        cells = {name: frame[place] for name, place in zip(columns, places, strict=True)}
        notes = self._found.notes(self.path.name, [number - 1 for number in below])
        return replace(self.table, columns=cells, notes=notes, more=None)

    def _open(self) -> TextIO:
        return self.path.open(encoding=self._encoding, errors="replace")

    def _scan(self) -> tuple[list[int], int, list[int], tuple[bool, bool]]:
        """Return blank lines, the count of rows, lines below the table, and if commas are decimal, points of thousands.

        InputError for a line inside the table that has not as many cells as the others."""
        separator, width = self._separator, self._width
        blanks: list[int] = []
        below: list[tuple[int, int]] = []
        last: deque[tuple[int, str]] = deque(maxlen=MOST_TOTALS)
        count, comma, thousands = 0, False, False
        with self._open() as file:
            for number, line in enumerate(_lines(file, self.path), 1):
                if number <= self._found.first:
                    continue
                if line.isspace():
                    blanks.append(number)
                    continue
                cells = len(line.split()) if separator == " " else line.count(separator) + 1
                cells = cells if cells == width else len(_cells(line, separator))
                if cells != width or (below and not self._goes_on(line)):
                    below.append((number, cells))
                    continue
                if below:
                    raise InputError(f"{self.path}, row {below[0][0]}: {told_width(below[0][1], width)} "
                                     f"({', '.join(self.table.names)})")  # fmt: skip
                last.append((number, line))
                count += 1
                if separator != "," and "," in line:
                    comma, thousands = True, thousands or bool(POINT_AND_COMMA.search(line))
        while last and not self._goes_on(last[-1][1]):
            below.append((last.pop()[0], width))
            count -= 1
        return blanks, count, sorted(number for number, _ in below), (comma, thousands)

    def _goes_on(self, line: str) -> bool:
        return self._found.goes_on(_cells(line, self._separator))

    def _frame(self, places: Sequence[int], count: int, marks: tuple[bool, bool]) -> pandas.DataFrame:
        """Return columns, cells with a decimal comma in columns of text put with a point."""
        import pandas

        separator = self._separator
        options: dict[str, Any] = {"decimal": ","} if marks[0] else {}
        if tuple(map(int, pandas.__version__.split(".")[:2])) < EXACT_SINCE:
            options["float_precision"] = "round_trip"
        for quoting in (csv.QUOTE_MINIMAL, csv.QUOTE_NONE):
            with self._open() as file, warnings.catch_warnings():
                warnings.simplefilter("ignore", pandas.errors.ParserWarning)  # the number of cells was checked
                next(islice(file, self._found.first - 1, None))
                frame: pandas.DataFrame = pandas.read_csv(
                    file, sep=r"\s+" if separator == " " else separator, header=None, names=range(self._width),
                    usecols=sorted(places), nrows=count, index_col=False, low_memory=False, skipinitialspace=True,
                    na_values=NO_READING, quoting=quoting, on_bad_lines="skip", **options,
                )  # fmt: skip
            if len(frame) == count:
                break
        else:
            raise InputError(f"{self.path}: changed while it was read, or has line breaks inside quotes")
        for place in places if marks[0] else ():
            if frame[place].dtype.kind not in "biuf":
                frame[place] = frame[place].map(partial(_with_point, thousands=marks[1]), na_action="ignore")
        return frame[list(places)]


def _encoding(path: Path) -> str:
    """Return how a file of text is encoded: UTF-16 by its mark, UTF-8, else as Windows does in Western Europe."""
    with path.open("rb") as file:
        head = file.read(1 << 20)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if not head.strip():
        raise InputError(f"{path}: is empty, expected a table with a header")
    if b"\0" in head:
        raise InputError(f"{path}: is not plain text (a binary file), expected a table of text")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _lines(file: TextIO, path: Path) -> Iterator[str]:
    while line := file.readline(MAX_LINE):
        if len(line) == MAX_LINE:
            raise InputError(f"{path}: a line is longer than {MAX_LINE >> 20} MiB, expected one sample a line")
        yield line


def _cells(line: str, separator: str) -> list[str]:
    """Split a line; the mark of a comment stays with the first cell."""
    text = line.strip("\r\n ")
    mark = text[:1] if text.startswith(COMMENTS) else ""
    text = text[len(mark) :].lstrip(" ") if mark else text
    cells = (
        text.split() if separator == " " else next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    )
    cells = [cell.strip(' "') for cell in cells]
    return [mark + cells[0], *cells[1:]] if cells else [mark]


def _with_point(cell: str, thousands: bool) -> str:
    text = cell.strip(' "')
    number, unit = measured(text)
    if unit:
        return f"{_with_point(number, thousands)} {unit}"
    if not re.fullmatch(NUMBER, text) or re.fullmatch(DATE, text):
        return cell
    return (text.replace(".", "") if thousands else text).replace(",", ".")


def free_memory() -> int:
    """Count the bytes that this process may still take: what the system has, and its control group's limit."""
    free = 1 << 30
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        free = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    with suppress(OSError, ValueError):
        limit, used = (int(Path(f"/sys/fs/cgroup/memory.{name}").read_text()) for name in ("max", "current"))
        free = min(free, max(limit - used, 0))
    return free


#: Function of pandas that reads a file by its suffix, and the part of an installation that it needs.
READERS = {
    ".xlsx": ("read_excel", "excel"),
    ".xlsm": ("read_excel", "excel"),
    ".parquet": ("read_parquet", "parquet"),
    ".feather": ("read_feather", "parquet"),
}
#: Suffixes of tables that are not read, and what to do instead.
REFUSED = {".xls": "save it as .xlsx or CSV", ".ods": "save it as .xlsx or CSV", ".pkl": "write it as CSV or Parquet"}
#: Rows of a sheet in which its table is looked for.
MOST_ROWS = 200


def frame_table(path: Path) -> Table | None:
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
    frame = read_by(partial(getattr(pandas, reader), **options), path, extra, " as a table")
    if extra == "excel":
        return _sheet(path, frame)
    if frame.index.name is not None and frame.index.name not in frame.columns:
        frame = frame.reset_index()
    return _of_frame(path, frame.set_axis(range(1, len(frame) + 1), axis=0), str(path))


def _of_frame(path: Path, frame: pandas.DataFrame, where: str, notes: tuple[str, ...] = ()) -> Table:
    """Return a table whose rows are numbered by the index of a frame."""
    if not len(frame):
        raise InputError(f"{path}: holds a header but no data, expected one sample a row")
    names = [str(column).strip() for column in frame.columns]
    columns = {name: frame.iloc[:, names.index(name)] for name in names}
    return Table(path, names, columns, where, "row", notes=notes)


def _sheet(path: Path, sheets: dict[str, pandas.DataFrame]) -> Table:
    """Return the table of the first sheet that has one; its columns are those with a name."""
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
        frame = data.iloc[:, used].set_axis(range(found.first + 1, stop + 1), axis=0).infer_objects()
        where = f"{path}, sheet {title}"
        notes = found.notes(f"{path.name}, sheet {title}", below)
        return _of_frame(path, frame, f"{where}, row {found.header[0] + 1}", notes)
    raise InputError(f"{path}: no sheet has a row of names above rows of numbers")


def read_by(reader: Callable[[Path], Read], path: Path, extra: str, kind: str = "") -> Read:
    """Return what a reader makes of a file; InputError where it is not installed or fails."""
    try:
        return reader(path)
    except ImportError:
        raise InputError(
            f"{path}: reading {path.suffix} files needs a further package: pip install 'aero-bayes[{extra}]', or write "
            "the signals as CSV"
        ) from None
    except InputError:
        raise
    except Exception as error:
        reason = f"{error}".partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: cannot be read{kind}: {reason}") from None


def _text(cell: Any) -> str:
    return "" if cell is None or cell != cell else str(cell).strip()
