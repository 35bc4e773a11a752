"""Signals of a file by name, and how signals with clocks of their own come to one time."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError

#: Decimals of a time in s within which two instants are one.
SAME_INSTANT = 9
#: What to do about a signal that is not there, unless its file cannot give it.
MAP_COLUMNS = "; map it with columns in the configuration"


def _sample(row: int) -> str:
    return f"sample {row + 1}"


@dataclass(frozen=True)
class Request:
    """What a recording asks of a file."""

    sources: Mapping[str, str]
    wanted: Sequence[str]
    optional: Sequence[str]
    held: Collection[str]
    memory: int | None = None
    batch: str | None = None


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
    bad: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    origin: float = 0.0
    batch: Sequence[str] | None = None
    note: str = ""


@dataclass(frozen=True)
class Signals:
    """Vectors of a file by name; ``clocks`` has the name of the times of those that have their own.

    ``hint`` says what to do about one that is not there."""

    vectors: Mapping[str, FloatArray]
    clocks: Mapping[str, str] = field(default_factory=dict)
    hint: str = MAP_COLUMNS


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


def pick_signals(path: Path, signals: Signals, request: Request) -> Columns:
    """Return the signals that a recording asks for, at one time."""
    if request.batch is not None and request.batch not in signals.vectors:
        raise InputError(f"{path}: no column {request.batch}, expected that of [data] batch")
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    named = {}
    for name in (*request.wanted, *request.optional):
        if (called := column_called(request.sources[name], signals.vectors)) is not None:
            named[name] = called
    clocks = {n: signals.clocks[c] for n, c in named.items() if c in signals.clocks and n != "time"}
    own = "time" not in named or named["time"] in signals.clocks.values()
    if own and len(clocks) == len([n for n in named if n != "time"]) > 0:
        named.setdefault("time", next(iter(clocks.values())))
    shown = ", ".join([*signals.vectors][:20]) or "nothing"
    for name in request.wanted:
        if name not in named:
            raise InputError(f"{path}: no column {request.sources[name]}, found {shown}{signals.hint}")
    if own and len(set(clocks.values())) > 1:
        first = signals.vectors[named["time"]]
        if not all(np.array_equal(signals.vectors[clock], first) for clock in clocks.values()):
            pairs = {n: (signals.vectors[clock], signals.vectors[named[n]]) for n, clock in clocks.items()}
            for name, (times, values) in pairs.items():
                _check_length(path, name, values, times.size)
            return Columns(joined(pairs, request.held), sha256, named)
    found = {name: signals.vectors[called] for name, called in named.items()}
    for name, values in found.items():
        _check_length(path, name, values, found["time"].size)
    labels = None if request.batch is None else [f"{label:g}" for label in signals.vectors[request.batch]]
    return Columns(found, sha256, named, batch=labels)


def _check_length(path: Path, name: str, values: FloatArray, length: int) -> None:
    if values.size != length:
        raise InputError(f"{path}, column {name}: {values.size} values, expected {length} as in time")


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


def without_repeats(columns: dict[str, FloatArray], held: Collection[str]) -> NDArray[np.bool_]:
    """Mark the rows to keep where a time is there twice at an event, as simulators write it: the last, after the event.

    It is an event where an input jumps between the two rows, or where they are equal."""
    time = columns["time"]
    repeated = np.flatnonzero(np.diff(time) == 0.0)
    keep = np.ones(time.size, dtype=bool)
    moved = np.zeros(repeated.size, dtype=bool)
    for name in held:
        moved |= np.diff(columns[name])[repeated] != 0.0
    differs = np.zeros(repeated.size, dtype=bool)
    for name, values in columns.items():
        if name != "time":
            with np.errstate(invalid="ignore"):
                differs |= np.abs(np.diff(values)[repeated]) > 0.0
    keep[repeated[moved | ~differs]] = False
    return keep
