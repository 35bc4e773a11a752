"""Find the table in rows of cells: the longest run of rows of one width that are mostly numbers, and its header."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from aero_bayes.data.cells import is_value
from aero_bayes.errors import InputError
from aero_bayes.modelica.units import is_unit, to_modelica_unit, unit_written_out

FindingKind = Literal[
    "sentinel", "outliers", "stuck", "clipped", "gap", "clock", "wrapped", "rounded", "quality", "unit", "sign", "swap",
    "value", "offset", "factor", "mean", "prior", "held", "noise", "feedback",
]  # fmt: skip

#: Times or rows of a finding that are told one by one.
MOST_TOLD = 6


@dataclass(frozen=True)
class DataFinding:
    """A fault of the readings."""

    kind: FindingKind
    recording: str
    signal: str
    what: str
    where: str
    done: str
    mended: bool

    @property
    def sentence(self) -> str:
        """All of it as text."""
        where = f" ({self.where})" if self.where else ""
        return f"{self.what.removesuffix('.')}{where}. {self.done}"


def told_numbers(numbers: Sequence[float], unit: str = "") -> str:
    """Write numbers in a sentence, the first few of many."""
    shown = ", ".join(f"{number:.7g}" for number in numbers[:MOST_TOLD])
    more = len(numbers) - MOST_TOLD
    return f"{shown}{f' {unit}' if unit else ''}{f' and {more} more' if more > 0 else ''}"


def runs_of(rows: Sequence[int]) -> str:
    """Write row numbers in a sentence, successive ones as a range: ``3, 7 to 9``."""
    ranges = np.split(np.asarray(rows), np.flatnonzero(np.diff(rows) != 1) + 1)
    parts = [f"{own[0]}" if own.size == 1 else f"{own[0]} to {own[-1]}" for own in ranges[:MOST_TOLD]]
    more = len(ranges) - MOST_TOLD
    return ", ".join(parts) + (f" and {more} more" if more > 0 else "")


#: Rows of words above a table that may belong to it: names, units, types.
MOST_HEADER_ROWS = 3
#: Cells that are no units; those of a row that is not one of units but of types, or of kinds of averages.
NO_UNIT = re.compile(r"|(double|single|float|u?int|real|bool(ean)?|string|char)\d*|ts|rn|-|none|n/?a", re.I)
NO_UNITS = re.compile(rf"{NO_UNIT.pattern}|avg|smp|max|min|std|tot", re.I)
#: Units as oscilloscopes spell them.
COMMENTS = ("#", "%")
#: Share of the cells of a column of values that are values.
MOSTLY = 0.6
Rows = Sequence[Sequence[str]]


@dataclass(frozen=True)
class Run:
    """Successive rows (from 0) that are mostly numbers, their width, the part of it in use, and how many are values."""

    start: int = 0
    stop: int = 0
    width: int = 0
    used: int = 0
    values: float = 0.0


@dataclass(frozen=True)
class Found:
    """A table: the names of its columns, the rows (from 0) of its header and its first row of data.

    ``lead`` is the first column that holds values, ``skipped`` are rows of cells above that are not read."""

    names: list[str]
    header: tuple[int, ...]
    first: int
    lead: int | None
    skipped: tuple[int, ...]

    def goes_on(self, row: Sequence[str]) -> bool:
        """Return whether a row of the table's width belongs to it: not if it is empty, or a word leads it."""
        return any(row) and (self.lead is None or not row[self.lead] or is_value(row[self.lead]))

    def notes(self, file: str, below: Sequence[int]) -> tuple[str, ...]:
        """Tell which rows above and below (from 0) are not read; nothing if all are."""
        rows = [r + 1 for r in (*self.skipped, *below)]
        if not rows:
            return ()
        which = f"rows {runs_of(rows)} are" if len(rows) > 1 else f"row {runs_of(rows)} is"
        return (f"{file}: the names stand in row {self.header[0] + 1}; {which} not read",)


def longest_run(rows: Rows) -> Run:
    """Find the longest run of rows of one width that are mostly numbers; rows without a cell do not end one."""
    spans: list[list[int]] = [[]]
    for r, row in enumerate(rows):
        kind = _kind(row)
        if kind == "numbers":
            if spans[-1] and len(row) != len(rows[spans[-1][0]]):
                spans.append([])
            spans[-1].append(r)
        elif kind == "mixed" and spans[-1] and len(row) == len(rows[spans[-1][0]]):
            spans[-1].append(r)  # readings may be words
        elif kind != "empty":
            spans.append([])
    longest = max(spans, key=len)
    if not longest:
        return Run()
    run = [[cell for cell in rows[r] if cell] for r in longest]
    share = sum(sum(map(is_value, cells)) / len(cells) for cells in run)
    used = max(_used(rows[r]) for r in longest)
    return Run(longest[0], longest[-1] + 1, len(rows[longest[0]]), used, share)


def with_header(rows: Rows, run: Run, where: str) -> Found:
    """Find the names, and units, above a run; InputError if there are none, or if other rows stand in between."""
    header = _header_above(rows, run, ()) or _header_above(rows, run, (run.start - 1,))
    between = (
        [r for r in range(header[-1] + 1, run.start) if _kind(rows[r]) not in ("empty", "comment")] if header else []
    )
    for r in between:
        if len(rows[r]) != run.width:
            raise InputError(f"{where}, row {r + 1}: {told_width(len(rows[r]), run.used)}")
    first = min(between, default=run.start)
    if len(header) < 2 and _is_header(
        rows[first], [row for row in rows[first + 1 : run.stop] if any(row)], bool(header)
    ):
        header, first = (*header, first), first + 1
    if len(header) > 1 and not _are_units(rows[header[1]]):
        header = header[1:]
    if not header:
        other = any(_kind(row) == "words" and _used(row) > 1 for row in rows[: run.start])
        expected = f"names above its {run.used} columns" if other else "a header such as time,u,y"
        raise InputError(f"{where}, row {run.start + 1}: holds numbers, expected {expected}")
    names = [cell.lstrip("".join(COMMENTS)).strip() if len(cell) > 1 else cell for cell in rows[header[0]]]
    names = [*names, *[""] * run.width][: max(_used(names), run.used)]
    names = with_units(names, rows[header[1]]) if len(header) > 1 else names
    data = [row for row in rows[first : run.stop] if any(row)]
    columns = [[row[k] for row in data if row[k]] for k in range(run.used)]
    lead = next((k for k, cells in enumerate(columns) if sum(map(is_value, cells)) > MOSTLY * len(cells)), None)
    above = (r for r in range(first) if r not in header[:2] and _kind(rows[r]) not in ("empty", "comment"))
    skipped = tuple(r for r in above if not rows[r][0].lower().startswith("sep="))
    return Found(names, header, first, lead, skipped)


def told_width(cells: int, expected: int) -> str:
    """Say how many cells a row has."""
    return f"{cells} {'cell' if cells == 1 else 'cells'}, expected {expected}"


def with_units(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return names of columns with the units of the row below them, ``F [N]``; types and the like are no units."""
    given = [u.strip("[]() ") for u in [*units, *[""] * len(names)]]
    no_unit = NO_UNITS if all(map(NO_UNITS.fullmatch, given)) else NO_UNIT
    known = ["" if no_unit.fullmatch(u) else unit_written_out(u) or u for u in given]
    return [(f"{n} [{u}]" if n else u) if u else n for n, u in zip(names, known, strict=False)]


def _are_units(row: Sequence[str]) -> bool:
    """Return whether at least half of the cells are units, types, or mean that there is no unit."""
    given = [u.strip("[]() ") for u in row if u]
    known = [is_unit(to_modelica_unit(u)) or NO_UNITS.fullmatch(u) or unit_written_out(u) for u in given]
    return 2 * sum(map(bool, known)) >= len(given)


def _kind(row: Sequence[str]) -> str:
    """Tell rows apart: ``empty``, ``comment``, ``numbers`` (mostly, or two at least), ``mixed`` or ``words``."""
    given = [cell for cell in row if cell]
    if not given:
        return "empty"
    if row[0].startswith(COMMENTS) and row[0] not in COMMENTS:
        return "comment"
    values = sum(map(is_value, given))
    if len(row) > 1 and (values >= 2 or 2 * values >= len(given)):
        return "numbers"
    return "mixed" if values else "words"


def _used(row: Sequence[str]) -> int:
    """Count the cells of a row up to its last that is not empty."""
    return max((k + 1 for k, cell in enumerate(row) if cell), default=0)


def _are_names(row: Sequence[str], run: Run) -> bool:
    used = _used(row)
    return run.used <= used <= run.width and 2 * sum(map(bool, row)) > used


def _header_above(rows: Rows, run: Run, may_hold_numbers: Sequence[int]) -> tuple[int, ...]:
    """Return the rows of names and units above a run, or of the last comment that can be names."""
    found: list[int] = []
    comment: tuple[int, ...] = ()
    for r in range(run.start - 1, -1, -1):
        kind = _kind(rows[r])
        if kind == "comment":
            comment = comment or ((r,) if not found and _are_names(rows[r], run) else ())
        fits = (
            (kind == "words" or (kind == "mixed" and r in may_hold_numbers))
            and _used(rows[r]) <= run.width
            and len(rows[r]) > 1
        )
        if fits and len(found) < MOST_HEADER_ROWS:
            found.append(r)
        elif found or comment:
            break
    names = next((k for k, r in reversed(list(enumerate(found))) if _are_names(rows[r], run)), None)
    return comment if names is None else tuple(reversed(found[: names + 1]))


def _is_header(first: Sequence[str], below: Rows, named: bool) -> bool:
    """Return whether the first row of a table belongs to its header: names of which most are numbers, ``time,1,2,3``.

    Below names it has units, and a word in every column that has cells below it."""
    words = [k for k, cell in enumerate(first) if cell and not is_value(cell)]
    if named:
        return bool(below) and all(k in words for k in range(len(first)) if any(row[k] for row in below))
    return bool(below) and any(all(is_value(row[k]) for row in below if row[k]) for k in words)
