"""One form for every file of readings: named columns, read when asked for; and what a recording takes of them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.data.cells import numbers_and_unit, times_in
from aero_bayes.errors import InputError
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas

Mask = NDArray[np.bool_]
#: Decimals of a time in s within which two instants are one.
SAME_INSTANT = 9
#: What to do about a signal that is not there, unless its file cannot give it.
MAP_COLUMNS = "; map it with columns in the configuration"
#: How a column is called that says of each row (or of one signal) whether it is good.
QUALITY_NAMES = ("quality", "dataquality", "status", "validity", "flag", "q")
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


def _sample(row: int) -> str:
    return f"sample {row + 1}"


@dataclass(frozen=True)
class Cells:
    """Columns as they were read, what names a row in messages, the first row's number, and what was not read."""

    columns: Mapping[str, pandas.Series]
    line: Callable[[int], str] = _sample
    first_row: int = 1
    note: str = ""

    def place(self, source: Source, rows: NDArray[np.intp] | None = None) -> Callable[[int], str]:
        """Return what names a row, or one of some rows, with the file."""
        return lambda row: f"{source.path}, {self.line(row if rows is None else int(rows[row]))}"


@dataclass(frozen=True)
class Source:
    """A file: the names of its columns, where they stand, and their cells when they are asked for.

    ``clocks`` has the column of times of each that has its own, ``head`` the first rows of a table; ``hint`` says what
    to do about a missing column."""

    path: Path
    names: Sequence[str]
    cells: Callable[[Sequence[str]], Cells]
    where: str
    head: pandas.DataFrame | None = None
    clocks: Mapping[str, str] = field(default_factory=dict)
    hint: str = ""

    @classmethod
    def of_vectors(
        cls, path: Path, vectors: Mapping[str, FloatArray], clocks: Mapping[str, str], hint: str = MAP_COLUMNS
    ) -> Source:
        """Return a file of named vectors, which may differ in length."""
        import pandas

        def cells(names: Sequence[str]) -> Cells:
            return Cells({name: pandas.Series(vectors[name]) for name in names})

        return cls(path, list(vectors), cells, str(path), clocks=clocks, hint=hint)

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
        if self.head is not None and len(timed) == len(called) == len(text) == 1:
            return [timed[0], *sorted(set(_words(self.cells(text).columns[text[0]])))]
        return list(self.names)


@dataclass(frozen=True)
class Columns:
    """What a file gave: columns of equal length by the recording's names, and where they come from.

    ``named`` has what the file calls them, which may end in a unit; ``line`` names a row in messages, ``first_row`` is
    the number of the first; ``bad`` has rows of outputs that the file calls bad; ``origin`` is what was taken off the
    times, in s; ``batch`` names the run of each row; ``note`` tells what of the file was not read."""

    columns: dict[str, FloatArray]
    sha256: str
    named: Mapping[str, str] = field(default_factory=dict)
    line: Callable[[int], str] = _sample
    first_row: int = 1
    bad: Mapping[str, Mask] = field(default_factory=dict)
    origin: float = 0.0
    batch: Sequence[str] | None = None
    note: str = ""


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


def read_columns(
    source: Source,
    asked: Mapping[str, str],
    wanted: Collection[str],
    held: Collection[str],
    batch: str | None,
    words: Mapping[str, Mapping[str, float]],
) -> Columns:
    """Read the columns that a recording asks for, at one time: what the file calls each, and which it must have.

    ``held`` are the inputs, ``batch`` is the column that names the run of each row, and ``words`` has the words that
    stand for values of a signal."""
    with source.path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    labels = [] if batch is None else [source.column(batch)]
    rows = _in_rows(source, asked)
    if rows is not None:
        return replace(_of_rows(source, asked, wanted, held, (*rows, *labels), words), sha256=sha256)
    named = {n: c for n, name in asked.items() if (c := column_called(name, source.names)) is not None}
    if twice := next((c for c in named.values() if source.names.count(c) > 1), None):
        raise InputError(f"{source.where}: column {twice} appears {source.names.count(twice)} times, expected once")
    clocks = _clocks(source, named)
    if missing := next((n for n in wanted if n not in named and not (n == "time" and clocks)), None):
        raise source.no_column(asked[missing])
    about = _quality_columns(source.names, {n: c for n, c in named.items() if n not in held and n != "time"})
    found = source.cells(list(dict.fromkeys([*named.values(), *clocks.values(), *about, *labels])))
    place = found.place(source)
    bad: dict[str, Mask] = {}
    for column, signals in about.items():
        marked = _bad(found.columns[column])
        bad |= {s: bad.get(s, marked) | marked for s in signals if marked.any()}
    cells = {n: found.columns[c] for n, c in named.items() if n != "time"}
    # a cell that is marked as bad may hold a word
    cells |= {n: cells[n].astype(object).mask(marked, None) for n, marked in bad.items() if cells[n].dtype.kind == "O"}
    read = {n: numbers_and_unit(column, place, asked[n], words.get(n)) for n, column in cells.items()}
    values = {n: numbers for n, (numbers, _) in read.items()}
    named |= {n: _with_unit(named[n], unit) for n, (_, unit) in read.items() if unit}
    if clocks and source.clocks:
        first, *others = (found.columns[clock] for clock in dict.fromkeys(clocks.values()))
        if all(first.equals(other) for other in others):
            named["time"], clocks = named.get("time", next(iter(clocks.values()))), {}
    if not clocks and not labels and _is_sparse(values, held):
        clocks = dict.fromkeys(values, named["time"])
    for n, own in values.items():
        if own.size != (size := found.columns[clocks.get(n, named.get("time", ""))].size):
            raise InputError(f"{source.path}, column {n}: {own.size} values, expected {size} as in time")
    if not clocks:
        values["time"], origin = times_in(found.columns[named["time"]], place, asked["time"])
        run = found.columns[labels[0]].map(_label).tolist() if labels else None
        return Columns(values, sha256, named, found.line, found.first_row, bad, origin, run, found.note)
    times = {clock: times_in(found.columns[clock].dropna(), place, clock) for clock in dict.fromkeys(clocks.values())}
    begin, pairs = min(origin for _, origin in times.values()), {}
    for n, clock in clocks.items():
        time, origin = times[clock]
        seen = np.where(bad.get(n, False), np.nan, values[n])[found.columns[clock].notna()]
        pairs[n] = time + (origin - begin), seen
    return Columns(joined(pairs, held), sha256, named, note=found.note, origin=begin)


def _with_unit(called: str, unit: str) -> str:
    """Return what a column is called with the unit behind its numbers."""
    return f"{re.sub(r' .[^ ]*]$', '', called)} [{unit}]"


def _clocks(source: Source, named: Mapping[str, str]) -> dict[str, str]:
    """Return the column of times of each signal, where all signals have one of their own."""
    if "time" in named and named["time"] not in source.clocks.values():
        return {}
    own = {n: source.clocks[c] for n, c in named.items() if c in source.clocks and n != "time"}
    if source.clocks or "time" in named:
        return own if len(own) == len([n for n in named if n != "time"]) else {}
    return clocks_of(source.where, source.names, named)


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


def _is_sparse(values: Mapping[str, FloatArray], held: Collection[str]) -> bool:
    """Return whether a row holds what one clock read: inputs have empty cells, and no row an input and an output."""
    inputs = [np.isfinite(v) for n, v in values.items() if n in held]
    outputs = [np.isfinite(v) for n, v in values.items() if n not in held]
    if not inputs or not outputs or all(there.all() for there in inputs):
        return False
    if len({there.size for there in (*inputs, *outputs)}) > 1:
        return False
    driven, read = np.logical_or.reduce(inputs), np.logical_or.reduce(outputs)
    return bool(driven.any() and read.any() and not (driven & read).any())


def _in_rows(source: Source, asked: Mapping[str, str]) -> tuple[str, str, str] | None:
    """Return the columns of signals' names, times and values of a table with one reading a row.

    One of its columns of text has names of signals that no column is called by."""
    head, missing = source.head, {name for n, name in asked.items() if n != "time"} - set(source.names)
    if head is None or not missing or len(source.names) < 3:
        return None
    for column, name in enumerate(source.names):
        if name == asked["time"] or not set(_words(head.iloc[:, column])) & missing:
            continue
        where = f"{source.where}: holds one reading a row, of the signal in column {name}"
        others = [n for n in source.names if n != name]
        time = column_called(asked["time"], others)
        timed = [n for n in others if is_time_name(n.partition("[")[0])] if time is None else [time]
        if len(timed) != 1:
            raise InputError(f"{where}, but no column of times")
        numeric = (n for n in others if n != timed[0] and _is_numeric(head.iloc[:, source.names.index(n)]))
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
    source: Source,
    asked: Mapping[str, str],
    wanted: Collection[str],
    held: Collection[str],
    columns: Sequence[str],
    words: Mapping[str, Mapping[str, float]],
) -> Columns:
    """Read signals from a table with one reading a row, at the union of their times.

    ``columns`` has their names, times and values, and labels of runs if there are any."""
    about = [n for n in source.names if re.sub(r"[\W_]", "", n.casefold()) in QUALITY_NAMES]
    found = source.cells(list(dict.fromkeys([*columns, *about])))
    time, origin = times_in(found.columns[columns[1]], found.place(source), columns[1])
    whose, valued = np.array(_words(found.columns[columns[0]])), found.columns[columns[2]]
    good = ~np.logical_or.reduce([np.zeros(time.size, dtype=bool), *(_bad(found.columns[c]) for c in about)])
    runs = found.columns[columns[3]].map(_label).to_numpy() if len(columns) > 3 else np.full(time.size, "")
    parts: dict[str, dict[str, FloatArray]] = {}
    units: dict[str, str] = {}
    for run in dict.fromkeys(runs.tolist()):
        pairs = {}
        for name, called in ((n, c) for n, c in asked.items() if n != "time"):
            own = np.flatnonzero((whose == called) & (runs == run) & good)
            if own.size == 0 and name in wanted:
                raise InputError(f"{source.path}: no reading of {called} in column {columns[0]}"
                                 f"{known_names_hint(called, sorted(set(whose)))}")  # fmt: skip
            own = own[np.argsort(time[own], kind="stable")]
            place = found.place(source, own)
            values, units[name] = numbers_and_unit(valued.iloc[own], place, called, words.get(name))
            twice = np.flatnonzero((np.diff(time[own]) == 0.0) & (np.diff(values) != 0.0))
            if twice.size:
                told = f"{place(int(twice[0] + 1))}: a second reading of {called} for one time; if the table holds"
                raise InputError(f"{told} several runs, make a recording of each",
                                 f"{told} several runs, name their column in [data] batch")  # fmt: skip
            pairs[name] = (time[own], values)
        parts[run] = joined(pairs, held)
    whole = {n: np.concatenate([part[n] for part in parts.values()]) for n in next(iter(parts.values()))}
    whole = {n: v for n, v in whole.items() if np.isfinite(v).any()}
    labels = [run for run, part in parts.items() for _ in part["time"]] if len(columns) > 3 else None
    named = {n: _with_unit(asked[n], units[n]) if units.get(n) else asked[n] for n in whole}
    return Columns(whole, "", named, origin=origin, batch=labels, note=found.note)


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
        if own or plain(name) in QUALITY_NAMES:
            about[name] = list(signals) if plain(name) in QUALITY_NAMES else own
    return about


def _bad(column: pandas.Series) -> Mask:
    """Mark rows whose cell of quality says that the reading is none."""
    if column.dtype.kind in "biuf":
        return np.zeros(len(column), dtype=bool)
    return np.asarray(column.astype(str).str.contains(BAD_WORDS), dtype=bool)


def joined(pairs: Mapping[str, tuple[FloatArray, FloatArray]], held: Collection[str]) -> dict[str, FloatArray]:
    """Join signals with clocks of their own at all of their times, from the first at which every input is known."""
    import pandas

    known = {
        n: pandas.Series(v, np.round(t, SAME_INSTANT))[np.isfinite(t) & np.isfinite(v)] for n, (t, v) in pairs.items()
    }
    frame = pandas.DataFrame({n: s[~s.index.duplicated(keep="last")] for n, s in known.items()}).sort_index()
    inputs = [n for n in frame if n in held and len(known[n])]
    frame[inputs] = frame[inputs].ffill()
    frame = frame.dropna(subset=inputs)
    return {"time": frame.index.to_numpy(dtype=float)} | {n: frame[n].to_numpy() for n in frame}


def without_repeats(columns: Mapping[str, FloatArray], held: Collection[str]) -> Mask:
    """Mark the rows to keep where a time is there twice at an event, as simulators write it: the last, after the event.

    It is an event where an input jumps between the two rows, or where they are equal."""
    repeated = np.flatnonzero(np.diff(columns["time"]) == 0.0)
    steps = {name: np.diff(values)[repeated] for name, values in columns.items() if name != "time"}
    moved = np.logical_or.reduce([np.zeros(repeated.size, dtype=bool), *(steps[name] != 0.0 for name in held)])
    differs = np.logical_or.reduce([moved, *(np.abs(step) > 0.0 for step in steps.values())])
    keep = np.ones(columns["time"].size, dtype=bool)
    keep[repeated[moved | ~differs]] = False
    return keep
