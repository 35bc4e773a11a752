"""One form for every file of readings, a table of named columns; and what a recording takes of it."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.cells import numbers_and_unit, times_in
from aero_bayes.data.columns import Layout, Mask
from aero_bayes.errors import InputError
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas

#: Decimals of a time in s within which two instants are one.
SAME_INSTANT = 9
#: What to do about a signal that is not there, unless its file cannot give it.
MAP_COLUMNS = "; map it with columns in the configuration"
#: How a column is called that says of each row (or of one signal) whether it is good.
QUALITY_NAMES = ("quality", "dataquality", "status", "validity", "flag", "q")
#: Rows in which a column of signals' names is looked for.
HEAD = 20
#: Words for a reading that is none.
BAD_WORDS = r"(?i)bad|invalid|uncertain|err|fail|fault|offline|no.?data|not.?connected|questionable|\bnok\b"
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
class Table:
    """Columns of a file as they stand in it, which may differ in length; the index of each numbers its rows there.

    ``row`` is what a row is called, ``where`` the place of the names. ``clocks`` has the column of times of each that
    has its own; ``hint`` says what to do about a missing column, ``notes`` what of the file is not read. A table of
    text has its first rows only, and ``more`` reads all of some columns."""

    path: Path
    names: Sequence[str]
    columns: Mapping[str, pandas.Series]
    where: str
    row: str = "sample"
    clocks: Mapping[str, str] = field(default_factory=dict)
    hint: str = ""
    notes: tuple[str, ...] = ()
    more: Callable[[Sequence[str]], Table] | None = None

    @classmethod
    def of_vectors(
        cls, path: Path, vectors: Mapping[str, FloatArray], clocks: Mapping[str, str], hint: str = MAP_COLUMNS
    ) -> Table:
        """Return a file of named vectors, which may differ in length."""
        import pandas

        columns = {n: pandas.Series(v, index=pandas.RangeIndex(1, v.size + 1)) for n, v in vectors.items()}
        return cls(path, list(vectors), columns, str(path), clocks=clocks, hint=hint)

    def read(self, names: Sequence[str]) -> Table:
        """Return the table with all rows of some columns."""
        return self if self.more is None else self.more(list(dict.fromkeys(names)))

    def no_column(self, name: str) -> InputError:
        """Return the error for a column that is not there."""
        found = known_names_hint(name, self.names) if self.names else ", found nothing"
        return InputError(f"{self.where}: no column {name}{found}{self.hint}")

    def column(self, name: str) -> str:
        """Return what the file calls a column; InputError if it has none."""
        called = column_called(name, self.names)
        if called is None:
            raise self.no_column(name)
        return called

    def signal_names(self) -> list[str]:
        """Return names of signals in a table with one reading a row, for those who ask what a file holds.

        Else its columns."""
        timed = [n for n in self.names if is_time_name(n.partition("[")[0])]
        called = [n for n in self.names if VALUE_NAME.fullmatch(n)]
        text = [n for n in self.names if SIGNAL_NAME.fullmatch(n)]
        if self.row == "row" and len(timed) == len(called) == len(text) == 1:
            return [timed[0], *sorted(set(_words(self.read(text).columns[text[0]])))]
        return list(self.names)


@dataclass(frozen=True)
class Signals:
    """Columns of a recording as they stand in its file, at one time; the index of the frame has the rows there.

    ``called`` is what the file calls them, which may end in a unit. ``bad`` has the rows of outputs that the file calls
    bad, ``batch`` the name of each row's run; ``origin`` is what was taken off the times, in s; ``told`` says what of
    the file was not read."""

    frame: pandas.DataFrame
    called: Mapping[str, str]
    told: tuple[str, ...] = ()
    row: str = "sample"
    bad: Mapping[str, pandas.Index] = field(default_factory=dict)
    origin: float = 0.0
    batch: pandas.Series | None = None
    sha256: str = ""


def column_called(source: str, names: Iterable[str]) -> str | None:
    """Return the name in a file that a signal's name means: itself, or the only one that adds a unit or a place to it.

    ``F`` is ``F [N]``, and ``run.F`` or ``group/F`` where there is one such signal."""
    there = list(names)
    if source in there:
        return source
    for called in (
        [n for n in there if n.startswith(f"{source} [")],
        [n for n in there if n.partition(" [")[0].endswith((f".{source}", f"/{source}"))],
    ):
        if len(called) == 1:
            return called[0]
    return None


def read_signals(
    table: Table, layout: Layout, names: Sequence[str], wanted: Collection[str], batch: str | None = None
) -> Signals:
    """Read signals of a recording at one time, of which the file must have those that are ``wanted``.

    ``batch`` is the column that names the run of each row."""
    import pandas

    asked, held = {name: layout.called[name] for name in ("time", *names)}, layout.held
    labels = [] if batch is None else [table.column(batch)]
    rows = _in_rows(table, asked)
    if rows is not None:
        return _of_rows(table, asked, wanted, layout, (*rows, *labels))
    named = {n: c for n, name in asked.items() if (c := column_called(name, table.names)) is not None}
    if twice := next((c for c in named.values() if table.names.count(c) > 1), None):
        raise InputError(f"{table.where}: column {twice} appears {table.names.count(twice)} times, expected once")
    clocks = _clocks(table, named)
    if missing := next((n for n in ("time", *wanted) if n not in named and not (n == "time" and clocks)), None):
        raise table.no_column(asked[missing])
    about = _quality_columns(table.names, {n: c for n, c in named.items() if n not in held and n != "time"})
    table = table.read([*named.values(), *clocks.values(), *about, *labels])
    columns, where = table.columns, f"{table.path}, {table.row}"
    bad: dict[str, Mask] = {}
    for column, signals in about.items():
        marked = _bad(columns[column])
        bad |= {s: bad.get(s, marked) | marked for s in signals if marked.any()}
    cells = {n: columns[c] for n, c in named.items() if n != "time"}
    # a cell that is marked as bad may hold a word
    cells |= {n: cells[n].astype(object).mask(marked, None) for n, marked in bad.items() if cells[n].dtype.kind == "O"}
    read = {n: numbers_and_unit(column, where, asked[n], layout.words[n]) for n, column in cells.items()}
    values = {n: numbers for n, (numbers, _) in read.items()}
    named |= {n: _with_unit(named[n], unit) for n, (_, unit) in read.items() if unit}
    if clocks and table.clocks:
        first, *others = (columns[clock] for clock in dict.fromkeys(clocks.values()))
        if all(first.equals(other) for other in others):
            named["time"], clocks = named.get("time", next(iter(clocks.values()))), {}
    for n, own in values.items():
        if own.size != (size := columns[clocks.get(n, named.get("time", ""))].size):
            raise InputError(f"{table.path}, column {n}: {own.size} values, expected {size} as in time")
    if not clocks:
        timed = columns[named["time"]]
        frame = pandas.DataFrame(values, index=timed.index)
        if labels or not _is_sparse(frame, held):
            frame["time"], origin = times_in(timed, where, asked["time"])
            marks = {n: timed.index[marked] for n, marked in bad.items()}
            run = columns[labels[0]].map(_label) if labels else None
            return Signals(frame, named, table.notes, table.row, marks, origin, run)
        clocks = dict.fromkeys(values, named["time"])
    times = {clock: times_in(columns[clock].dropna(), where, clock) for clock in dict.fromkeys(clocks.values())}
    begin, pairs = min(origin for _, origin in times.values()), {}
    for n, clock in clocks.items():
        time, origin = times[clock]
        seen = np.where(bad.get(n, False), np.nan, values[n])[columns[clock].notna()]
        pairs[n] = time + (origin - begin), seen
    return Signals(joined(pairs, held), named, table.notes, origin=begin)


def _with_unit(called: str, unit: str) -> str:
    """Return what a column is called with the unit behind its numbers."""
    return f"{re.sub(r' .[^ ]*]$', '', called)} [{unit}]"


def _clocks(table: Table, named: Mapping[str, str]) -> dict[str, str]:
    """Return the column of times of each signal, where all signals have one of their own."""
    if "time" in named and named["time"] not in table.clocks.values():
        return {}
    own = {n: table.clocks[c] for n, c in named.items() if c in table.clocks and n != "time"}
    if table.clocks or "time" in named:
        return own if len(own) == len([n for n in named if n != "time"]) else {}
    return clocks_of(table.where, table.names, named)


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


def _is_sparse(frame: pandas.DataFrame, held: Collection[str]) -> bool:
    """Return whether a row holds what one clock read: inputs have empty cells, and no row an input and an output."""
    there = np.isfinite(frame)
    inputs = there[[n for n in frame if n in held]]
    driven, read = inputs.any(axis=1), there.drop(columns=inputs.columns).any(axis=1)
    return bool(not inputs.all(axis=None) and driven.any() and read.any() and not (driven & read).any())


def _in_rows(table: Table, asked: Mapping[str, str]) -> tuple[str, str, str] | None:
    """Return the columns of signals' names, times and values of a table with one reading a row.

    One of its columns of text has names of signals that no column is called by."""
    missing = {name for n, name in asked.items() if n != "time"} - set(table.names)
    if table.row != "row" or not missing or len(table.names) < 3:
        return None
    head = {name: column.head(HEAD) for name, column in table.columns.items()}
    for name in table.names:
        if name == asked["time"] or not set(_words(head[name])) & missing:
            continue
        where = f"{table.where}: holds one reading a row, of the signal in column {name}"
        others = [n for n in table.names if n != name]
        time = column_called(asked["time"], others)
        timed = [n for n in others if is_time_name(n.partition("[")[0])] if time is None else [time]
        if len(timed) != 1:
            raise InputError(f"{where}, but no column of times")
        numeric = (n for n in others if n != timed[0] and _is_numeric(head[n]))
        left = [n for n in others if VALUE_NAME.fullmatch(n)] or list(numeric)
        if len(left) != 1:
            raise InputError(
                f"{where}, but {', '.join(left) or 'no column'} may be its value; expected one column value"
            )
        return name, timed[0], left[0]
    return None


def _is_numeric(column: pandas.Series) -> bool:
    import pandas

    return bool(pandas.to_numeric(column, errors="coerce").notna().any())


def _of_rows(
    table: Table, asked: Mapping[str, str], wanted: Collection[str], layout: Layout, columns: Sequence[str]
) -> Signals:
    """Read signals from a table with one reading a row, at the union of their times.

    ``columns`` has their names, times and values, and labels of runs if there are any."""
    import pandas

    about = [n for n in table.names if re.sub(r"[\W_]", "", n.casefold()) in QUALITY_NAMES]
    table = table.read([*columns, *about])
    found, where = table.columns, f"{table.path}, {table.row}"
    time, origin = times_in(found[columns[1]], where, columns[1])
    whose, valued = np.array(_words(found[columns[0]])), found[columns[2]]
    good = ~np.logical_or.reduce([np.zeros(time.size, dtype=bool), *(_bad(found[c]) for c in about)])
    runs = found[columns[3]].map(_label).to_numpy() if len(columns) > 3 else np.full(time.size, "")
    parts: dict[str, pandas.DataFrame] = {}
    units: dict[str, str] = {}
    for run in dict.fromkeys(runs.tolist()):
        pairs = {}
        for name, called in ((n, c) for n, c in asked.items() if n != "time"):
            own = np.flatnonzero((whose == called) & (runs == run) & good)
            if own.size == 0 and name in wanted:
                raise InputError(f"{table.path}: no reading of {called} in column {columns[0]}"
                                 f"{known_names_hint(called, sorted(set(whose)))}")  # fmt: skip
            own = own[np.argsort(time[own], kind="stable")]
            values, units[name] = numbers_and_unit(valued.iloc[own], where, called, layout.words[name])
            twice = np.flatnonzero((np.diff(time[own]) == 0.0) & (np.diff(values) != 0.0))
            if twice.size:
                told = f"{where} {valued.index[own[twice[0] + 1]]}: a second reading of {called} for one time; if the "
                raise InputError(f"{told}table holds several runs, make a recording of each",
                                 f"{told}table holds several runs, name their column in [data] batch")  # fmt: skip
            pairs[name] = (time[own], values)
        parts[run] = joined(pairs, layout.held)
    frame = _numbered(pandas.concat(parts.values()).dropna(axis=1, how="all"))
    labels = np.repeat(list(parts), [len(part) for part in parts.values()])
    named = {n: _with_unit(asked[n], units[n]) if units.get(n) else asked[n] for n in frame if n != "time"}
    batch = pandas.Series(labels, frame.index) if len(columns) > 3 else None
    return Signals(frame, named, table.notes, origin=origin, batch=batch)


def _numbered(frame: pandas.DataFrame) -> pandas.DataFrame:
    """Return a frame whose rows are samples from 1 on."""
    return frame.set_axis(range(1, len(frame) + 1), axis=0)


def _words(column: pandas.Series) -> list[str]:
    return [str(cell).strip() for cell in column]


def _label(cell: object) -> str:
    """Return how a batch is called: 3 rather than 3.0."""
    return f"{cell:g}" if isinstance(cell, float) else str(cell).strip()


def _quality_columns(names: Sequence[str], signals: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the signals that each column of quality words is about, by the column's name.

    ``signals`` has the column of each signal. A column that names no signal is about all of them."""

    def plain(text: str) -> str:
        return re.sub(r"\[.*\]|[\W_]", "", text.casefold())

    about: dict[str, list[str]] = {}
    for name in (n for n in names if n not in signals.values()):
        own = [s for s, column in signals.items() if plain(name) in {plain(column) + q for q in QUALITY_NAMES}]
        if own := list(signals) if plain(name) in QUALITY_NAMES else own:
            about[name] = own
    return about


def _bad(column: pandas.Series) -> Mask:
    """Mark rows whose cell of quality says that the reading is none."""
    if column.dtype.kind in "biuf":
        return np.zeros(len(column), dtype=bool)
    return np.asarray(column.astype(str).str.contains(BAD_WORDS), dtype=bool)


def joined(pairs: Mapping[str, tuple[FloatArray, FloatArray]], held: Collection[str]) -> pandas.DataFrame:
    """Join signals with clocks of their own at all of their times, from the first at which every input is known."""
    import pandas

    known = {
        n: pandas.Series(v, np.round(t, SAME_INSTANT))[np.isfinite(t) & np.isfinite(v)] for n, (t, v) in pairs.items()
    }
    frame = pandas.DataFrame({n: s[~s.index.duplicated(keep="last")] for n, s in known.items()}).sort_index()
    inputs = [n for n in frame if n in held and len(known[n])]
    frame[inputs] = frame[inputs].ffill()
    return _numbered(frame.dropna(subset=inputs).rename_axis("time").reset_index())


def without_repeats(frame: pandas.DataFrame, held: Collection[str]) -> pandas.DataFrame:
    """Return rows without those where a time is there twice at an event, as simulators write it, but for the last.

    It is an event where an input jumps between the two rows, or where they are equal."""
    steps = frame.diff().iloc[1:]
    others = steps.drop(columns="time")
    moved = (others[[n for n in held if n in others]] != 0.0).any(axis=1)
    differs = moved | (others.abs() > 0.0).any(axis=1)
    return frame[np.append(~((steps["time"] == 0.0) & (moved | ~differs)), True)]
