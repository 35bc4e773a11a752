"""Tables that pandas reads: Excel, where the header may stand below a title, Parquet and Feather."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data.cells import numbers_in, times_in
from aero_bayes.data.find_table import longest_run, with_header
from aero_bayes.data.signals import Columns, Request, column_called, joined
from aero_bayes.errors import InputError
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas


Mask = NDArray[np.bool_]

#: How a column is called that says of each row (or of one signal) whether it is good.
QUALITY_NAMES = ("quality", "dataquality", "status", "validity", "flag", "q")
#: Words for a reading that is none.
BAD_WORDS = re.compile(
    r"bad|invalid|uncertain|err|fail|fault|offline|no.?data|not.?connected|questionable|\bnok\b", re.I
)
#: How columns of signals' names and of their values are called in a table with one reading a row.
SIGNAL_NAME = re.compile(r"_?(tag|signal|variable|channel|sensor|point|field|name)[ _]?(name|id)?", re.IGNORECASE)
VALUE_NAME = re.compile(r"_?(value|val|reading|wert)( \[.*\])?", re.IGNORECASE)
#: What a column of times is called, without its unit.
TIME_NAMES = {"time", "timestamp", "zeit", "xvalue", "datetime"}


def is_time_name(name: str) -> bool:
    """Return whether a column's name, without its unit, is one of times: ``t``, but not ``T``."""
    plain = re.sub(r"[\W_]", "", name)
    return plain == "t" or plain.casefold() in TIME_NAMES


@dataclass(frozen=True)
class FileTable:
    """Columns as they were read, the hash of the file, the name of a row in messages, and the first row's number."""

    frame: pandas.DataFrame
    sha256: str
    line: Callable[[int], str]
    first_row: int
    note: str = ""

    def place(self, path: Path) -> Callable[[int], str]:
        """Return what names a row with the file."""
        return lambda row: f"{path}, {self.line(row)}"


class TableFile(Protocol):
    """A file that holds a table: its names, where they stand, and its columns when they are asked for."""

    path: Path
    names: list[str]
    where: str

    def head(self) -> pandas.DataFrame: ...

    def read(self, columns: Sequence[str], memory: int | None = None) -> FileTable: ...


@dataclass(frozen=True)
class _Rows:
    """Columns of a table in rows of readings: the column of names, of values, and of times."""

    signal: str
    value: str
    time: str


def read_table(file: TableFile, request: Request) -> Columns:
    """Read the columns that a recording asks for."""
    rows = _in_rows(file, request)
    if rows is not None:
        return _read_rows(file, request, rows)
    asked = {n: request.sources[n] for n in (*request.wanted, *request.optional)}
    named = {n: c for n, source in asked.items() if (c := column_called(source, file.names)) is not None}
    if twice := next((c for c in named.values() if file.names.count(c) > 1), None):
        raise InputError(f"{file.where}: column {twice} appears {file.names.count(twice)} times, expected once")
    clocks = {} if "time" in named else clocks_of(file.where, file.names, named)
    for name in request.wanted:
        if name not in named and not (name == "time" and clocks):
            raise _no_column(file, asked[name])
    about = _quality_columns(file.names, {n: c for n, c in named.items() if n not in request.held and n != "time"})
    batch = [] if request.batch is None else [_batch_column(file, request.batch)]
    table = file.read(list(dict.fromkeys([*named.values(), *clocks.values(), *about, *batch])), request.memory)
    place = table.place(file.path)
    bad: dict[str, Mask] = {}
    for column, signals in about.items():
        marked = _bad(table.frame[column])
        bad |= {s: bad.get(s, marked) | marked for s in signals if marked.any()}
    cells = {n: table.frame[c] for n, c in named.items() if n != "time"}
    # a cell that is marked as bad may hold a word
    cells |= {n: cells[n].astype(object).mask(marked, None) for n, marked in bad.items() if cells[n].dtype.kind == "O"}
    values = {n: numbers_in(column, place, request.sources[n]) for n, column in cells.items()}
    if not clocks and (batch or not _is_sparse(values, request.held)):
        values["time"], origin = times_in(table.frame[named["time"]], place, request.sources["time"])
        labels = table.frame[batch[0]].map(_label).tolist() if batch else None
        return Columns(values, table.sha256, named, table.line, table.first_row, bad, origin, labels, table.note)
    own = clocks or dict.fromkeys(values, named.get("time", ""))
    times = {clock: times_in(table.frame[clock].dropna(), place, clock) for clock in dict.fromkeys(own.values())}
    begin, pairs = min(origin for _, origin in times.values()), {}
    for n, clock in own.items():
        time, origin = times[clock]
        pairs[n] = time + (origin - begin), np.where(bad.get(n, False), np.nan, values[n])[: time.size]
    return Columns(joined(pairs, request.held), table.sha256, named, note=table.note, origin=begin)


def _no_column(file: TableFile, name: str) -> InputError:
    return InputError(f"{file.where}: no column {name}{known_names_hint(name, file.names)}")


def _batch_column(file: TableFile, name: str) -> str:
    column = column_called(name, file.names)
    if column is None:
        raise _no_column(file, name)
    return column


def _label(cell: object) -> str:
    """Return how a batch is called: 3 rather than 3.0."""
    return f"{cell:g}" if isinstance(cell, float) else str(cell).strip()


def _is_sparse(values: Mapping[str, NDArray[np.float64]], held: Collection[str]) -> bool:
    """Return whether a row holds what one clock read: inputs have empty cells, and no row an input and an output."""
    inputs = [np.isfinite(v) for n, v in values.items() if n in held]
    outputs = [np.isfinite(v) for n, v in values.items() if n not in held]
    if not inputs or not outputs or all(there.all() for there in inputs):
        return False
    driven, read = np.logical_or.reduce(inputs), np.logical_or.reduce(outputs)
    return bool(driven.any() and read.any() and not (driven & read).any())


def clocks_of(where: str, names: Sequence[str], named: Mapping[str, str]) -> dict[str, str]:
    """Return the column of times of each signal, where all signals have one: ``time_P`` beside ``P``, ``t [P]``."""
    clocks: dict[str, str] = {}
    for name in names:
        parts = re.split(r"[ _\-\[\].:]+", name.strip("[] "), maxsplit=1)
        if len(parts) == 2 and is_time_name(parts[0]):
            clocks |= {signal: name for signal, column in named.items() if parts[1] == column}
    without = [signal for signal in named if signal not in clocks]
    if len(set(clocks.values())) > 1 and without:
        raise InputError(
            f"{where}: columns {' and '.join(clocks.values())} are times of single signals, but {without[0]} has none: "
            "resample the signals to common times"
        )
    return {} if without else clocks


def _in_rows(file: TableFile, request: Request) -> _Rows | None:
    """Find the columns of a table with one reading a row.

    One of text has the names of signals that no column is called by."""
    missing = {request.sources[n] for n in (*request.wanted, *request.optional) if n != "time"} - set(file.names)
    if not missing or len(file.names) < 3:
        return None
    head = file.head()
    for column, name in enumerate(file.names):
        if name == request.sources["time"] or not set(head.iloc[:, column].astype(str).str.strip()) & missing:
            continue
        where = f"{file.where}: holds one reading a row, of the signal in column {name}"
        others = [n for n in file.names if n != name]
        time = column_called(request.sources["time"], others)
        timed = [n for n in others if is_time_name(n.partition("[")[0])] if time is None else [time]
        if len(timed) != 1:
            raise InputError(f"{where}, but no column of times")
        called = [n for n in others if VALUE_NAME.fullmatch(n)]
        left = called or [n for n in others if n != timed[0] and _is_numeric(head.iloc[:, file.names.index(n)])]
        if len(left) != 1:
            raise InputError(
                f"{where}, but {', '.join(left) or 'no column'} may be its value; expected one column value"
            )
        return _Rows(name, left[0], timed[0])
    return None


def _is_numeric(column: pandas.Series) -> bool:
    import pandas

    return bool(pandas.to_numeric(column, errors="coerce").notna().any())


def _read_rows(file: TableFile, request: Request, rows: _Rows) -> Columns:
    """Read signals from a table with one reading a row, at the union of their times."""
    about = [n for n in file.names if re.sub(r"[\W_]", "", n.casefold()) in QUALITY_NAMES]
    batch = [] if request.batch is None else [_batch_column(file, request.batch)]
    table = file.read(list(dict.fromkeys([rows.time, rows.signal, rows.value, *about, *batch])), request.memory)
    place = table.place(file.path)
    time, origin = times_in(table.frame[rows.time], place, rows.time)
    whose = table.frame[rows.signal].astype(str).str.strip().to_numpy()
    good = ~np.logical_or.reduce([np.zeros(time.size, dtype=bool), *(_bad(table.frame[c]) for c in about)])
    runs = table.frame[batch[0]].map(_label).to_numpy() if batch else np.full(time.size, "")
    parts: dict[str, dict[str, NDArray[np.float64]]] = {}
    for run in dict.fromkeys(runs.tolist()):
        pairs = {}
        for name in (n for n in (*request.wanted, *request.optional) if n != "time"):
            source = request.sources[name]
            own = np.flatnonzero((whose == source) & (runs == run) & good)
            if own.size == 0 and name in request.wanted:
                raise InputError(f"{file.path}: no reading of {source} in column {rows.signal}"
                                 f"{known_names_hint(source, sorted(set(whose)))}")  # fmt: skip
            own = own[np.argsort(time[own], kind="stable")]
            cells = table.frame[rows.value].iloc[own]
            values = numbers_in(cells, lambda row, own=own: place(int(own[row])), source)  # type: ignore[misc]
            twice = np.flatnonzero((np.diff(time[own]) == 0.0) & (np.diff(values) != 0.0))
            if twice.size:
                raise InputError(f"{place(int(own[twice[0] + 1]))}: a second reading of {source} for one time; if the "
                                 "table holds several runs, name their column in [data] batch")  # fmt: skip
            pairs[name] = (time[own], values)
        parts[run] = joined(pairs, request.held)
    columns = {n: np.concatenate([part[n] for part in parts.values()]) for n in next(iter(parts.values()))}
    columns = {n: v for n, v in columns.items() if np.isfinite(v).any()}
    labels = [run for run, part in parts.items() for _ in part["time"]] if batch else None
    named = {n: request.sources[n] for n in columns}
    return Columns(columns, table.sha256, named, origin=origin, batch=labels, note=table.note)


def row_names(file: TableFile) -> list[str]:
    """Return names of signals in a table with one reading a row, for those who ask what a file holds.

    Else its columns."""
    timed = [n for n in file.names if is_time_name(n.partition("[")[0])]
    called = [n for n in file.names if VALUE_NAME.fullmatch(n)]
    text = [n for n in file.names if SIGNAL_NAME.fullmatch(n)]
    if len(timed) == len(called) == len(text) == 1:
        return [timed[0], *sorted(set(file.read(text).frame[text[0]].astype(str).str.strip()))]
    return file.names


def _quality_columns(names: Sequence[str], signals: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the signals that each column of quality words is about, by the column's name.

    ``signals`` has the column of each signal. A column that names no signal is about all of them."""

    def plain(text: str) -> str:
        return re.sub(r"\[.*\]|[\W_]", "", text.casefold())

    about: dict[str, list[str]] = {}
    for name in names:
        if name in signals.values():
            continue
        if plain(name) in QUALITY_NAMES:
            about[name] = list(signals)
            continue
        own = [s for s, column in signals.items() if plain(name) in {plain(column) + q for q in QUALITY_NAMES}]
        if own:
            about[name] = own
    return about


def _bad(column: pandas.Series) -> Mask:
    """Mark rows whose cell of quality says that the reading is none."""
    return np.asarray(column.astype(str).str.contains(BAD_WORDS), dtype=bool)


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
        self.first_row, self.where, self._note = 1, str(path), ""
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
        return FileTable(found, digest, lambda row: f"row {row + first}", first, self._note)

    def _sheet(self, sheets: dict[str, pandas.DataFrame]) -> pandas.DataFrame:
        """Return the table of the first sheet that has one; its columns are those with a name."""
        for title, sheet in sheets.items():
            rows = [list(map(_text, row)) for row in sheet.head(MOST_ROWS).to_numpy()]
            run = longest_run(rows)
            if not run.stop:
                continue
            found = with_header(rows, run, f"{self.path}, sheet {title}")
            stop = len(sheet)
            while stop > found.first and not found.goes_on(list(map(_text, sheet.iloc[stop - 1]))):
                stop -= 1
            below = [r for r in range(stop, len(sheet)) if sheet.iloc[r].notna().any()]
            self._note = found.note(f"{self.path.name}, sheet {title}", below)
            self.first_row, self.where = found.first + 1, f"{self.path}, sheet {title}, row {found.header[0] + 1}"
            data = sheet.iloc[found.first : stop, : len(found.names)].set_axis(found.names, axis=1)
            used = [k for k, name in enumerate(found.names) if name]
            return data.iloc[:, used].reset_index(drop=True).infer_objects()
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


def _text(cell: Any) -> str:
    return "" if cell is None or cell != cell else str(cell).strip()
