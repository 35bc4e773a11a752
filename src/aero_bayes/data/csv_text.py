"""Columns of numbers out of a CSV file, in a stream.

The file is passed over twice: once to count its lines and hash it, so that the memory it needs is known before any is
taken, and once to parse blocks of lines into arrays of the right size. A block is parsed in bulk; only one that does
not parse is looked at cell by cell, by the code that decides what a number is and says where one is not.

Columns are separated by commas, by semicolons or tabs, where a comma is a decimal mark, or by spaces. Lines that begin
with ``#`` or ``%`` may stand above the header, a line of units below it (``F`` is then called ``F [N]``), and times may
be dates with a time of day (ISO 8601), or times of day. Other forms are in :mod:`aero_bayes.data.csv_forms`.
"""

from __future__ import annotations

import hashlib
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data.csv_forms import (
    CLOCK,
    FORTRAN,
    THOUSANDS,
    after_midnight,
    bad_rows,
    cells_of,
    check_layout,
    clock_seconds,
    skipped_preamble,
    with_commas,
)
from aero_bayes.errors import InputError
from aero_bayes.unknown_names import known_names_hint

FloatArray = NDArray[np.float64]
BLOCK_BYTES = 8 << 20
NUMBER = re.compile(rb"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
SPECIAL = re.compile(rb"[+-]?(nan|inf|infinity|1\.#\w+)", re.IGNORECASE)
TIMESTAMP = re.compile(rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?")
SEPARATORS = (b",", b";", b"\t")
COMMENTS = (b"#", b"%")
#: Lines in which the end of a file's own header is looked for.
MOST_PREAMBLE = 60
#: Cells of a switch.
SWITCHED = {b"true": 1.0, b"false": 0.0}
#: Where a byte can stand in a number that the bulk parser and NUMBER read alike; others go cell by cell.
IS_PLAIN_BYTE = np.zeros(256, dtype=bool)
IS_PLAIN_BYTE[list(b"0123456789+-.eE,\n\r")] = True


@dataclass(frozen=True)
class Header:
    """Names of a file's columns, what separates them, the line they stand in, and the bytes up to its end."""

    names: list[str]
    separator: bytes
    line: int
    size: int


@dataclass(frozen=True)
class CsvTable:
    """Columns of a file: values of shape (n,) by name, NaN where a cell was empty, and each row's line in the file."""

    columns: dict[str, FloatArray]
    sha256: str
    first_line: int
    skipped: tuple[int, ...]

    def line(self, row: int) -> int:
        """Line of the file, counted from 1, that holds row ``row``."""
        line = row + self.first_line
        for blank in self.skipped:
            if blank > line:
                break
            line += 1
        return line


def read_columns(path: Path, wanted: Sequence[str], optional: Sequence[str], memory: int | None = None) -> CsvTable:
    """Parse columns of a CSV file.

    Parameters
    ----------
    path : Path
    wanted, optional : sequence of str
        Headers that must be there, and that are read where they are. The first is that of the time, in s from the first
        sample on where it is given by dates.
    memory : int, optional
        Bytes that may be used; what the machine has free by default.

    Raises
    ------
    InputError
        One line with file, line and column: no such file, empty, header only, another separator, a decimal comma among
        commas, a column missing or twice, text in a number, a value that is not finite, too large for the memory.
    """
    header = read_header(path)
    check_layout(f"{path}, row {header.line}", header.names, wanted, _first_rows(path, header))
    picked = _pick(path, header, wanted, optional)
    sha256, lines = _scan(path)
    rows = max(lines - header.line, 0)
    if rows == 0:
        raise InputError(f"{path}: holds a header but no data, expected one sample a line")
    # Values, and as much again for what checks and later steps hold at once.
    needed, free = 2 * 8 * rows * len(picked) + 8 * BLOCK_BYTES, memory if memory is not None else free_memory()
    if needed > free:
        raise InputError(
            f"{path}: {rows:,} rows of {len(picked)} columns need {needed / 2**20:,.0f} MiB of memory, "
            f"{free / 2**20:,.0f} MiB are free: thin or cut the file, or run on a larger machine"
        )
    store = np.empty((len(picked), rows))
    skipped: list[int] = []
    row, line, dates, clock = 0, header.line + 1, False, False
    time = next(iter(picked))
    for block in _blocks(path, header):
        begin = _first_cell(block, picked[time]) if row == 0 else b""
        dates, clock = dates or bool(TIMESTAMP.fullmatch(begin)), clock or bool(CLOCK.fullmatch(begin))
        values, blanks, count = _parse(path, block, header.names, picked, line)
        if row + len(values) > rows:
            raise InputError(f"{path}: changed while it was read")
        store[:, row : row + len(values)] = values.T
        skipped += blanks
        row, line = row + len(values), line + count
    if row == 0:
        raise InputError(f"{path}: holds a header but no data, expected one sample a line")
    columns = {name: store[index, :row] for index, name in enumerate(picked)}
    if dates or clock:
        columns[time] = after_midnight(columns[time]) if clock else columns[time] - columns[time][0]
    return CsvTable(columns, sha256, header.line + 1, tuple(skipped))


def read_quality(path: Path, column: str, rows: int) -> NDArray[np.bool_]:
    """Which of the rows a column of quality words calls bad."""
    header = read_header(path)
    lines = (line for block in _blocks(path, header) for line in block.split(b"\n") if line.strip(b" \t\r"))
    return bad_rows(path, lines, header.names.index(column), rows)


def free_memory() -> int:
    """Bytes that this process may still take: what the system calls available, and its control group's limit."""
    try:
        free = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES")
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free = int(line.split()[1]) * 1024
    except (OSError, ValueError):
        free = 1 << 30
    try:
        limit = int(Path("/sys/fs/cgroup/memory.max").read_text())
        used = int(Path("/sys/fs/cgroup/memory.current").read_text())
        free = min(free, max(limit - used, 0))
    except (OSError, ValueError):
        pass
    return free


def read_header(path: Path) -> Header:
    """Names and layout of a file's columns.

    Raises
    ------
    InputError
        If the file is empty, no text in UTF-8, or begins with numbers.
    """
    raw, line, size = b"", 0, 0
    with path.open("rb") as file:
        above = skipped_preamble([file.readline(1 << 16) for _ in range(MOST_PREAMBLE)])
        file.seek(0)
        for _ in range(above):
            line, size = line + 1, size + len(file.readline(1 << 16))
        while line == above or raw.lstrip(b"\xef\xbb\xbf \t").startswith(COMMENTS):
            last, raw = raw, file.readline(1 << 20)
            line, size = line + 1, size + len(raw)
        below = file.readline(1 << 20)
    if not raw.strip():
        raise InputError(f"{path}: is empty, expected a CSV file with a header")
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in raw:
        raise InputError(f"{path}: is not plain text in UTF-8 (a binary or UTF-16 file), expected CSV")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}, row {line}: is not text in UTF-8, expected CSV") from None
    if "\r" in text.rstrip("\r\n"):
        raise InputError(f"{path}: lines end in a bare carriage return, expected line feeds")
    separator, names = _split(text)
    if _are_numbers(names) and last:
        # the header is often the last comment
        line, size = line - 1, size - len(raw)
        separator, names = _split(last.decode("utf-8-sig", "replace").strip(" \t#%\r\n"))
    if len(names) == 1 and re.search(r"\S[ \t]+\S", names[0]):
        separator, names = b" ", names[0].split()
    if _are_numbers(names):
        raise InputError(f"{path}, row {line}: holds numbers, expected a header such as time,u,y")
    below = FORTRAN.sub(rb"\1e\2", below)
    units = [_bare(cell) for cell in (below.split() if separator == b" " else below.split(separator))]
    numbers = any(form.fullmatch(cell.replace(b",", b".")) for form in (NUMBER, SPECIAL, TIMESTAMP) for cell in units)
    if len(units) == len(names) > 1 and any(units) and not numbers:
        marks = (f" [{unit.decode('utf-8', 'replace')}]" if unit else "" for unit in units)
        names, line, size = [n + m for n, m in zip(names, marks, strict=True)], line + 1, size + len(below)
    return Header(names, separator, line, size)


def _split(text: str) -> tuple[bytes, list[str]]:
    """What separates the names of a header, and the names."""
    separator = max(SEPARATORS, key=lambda mark: text.count(mark.decode()))
    return separator, [name.strip().strip('"').strip() for name in text.strip("\r\n ").split(separator.decode())]


def _are_numbers(names: list[str]) -> bool:
    return all(NUMBER.fullmatch(name.replace(",", ".").encode()) for name in names if name)


def _first_cell(block: bytes, column: int) -> bytes:
    cells = block.lstrip(b" \r\n").partition(b"\n")[0].split(b",")
    return _bare(cells[column]) if len(cells) > column else b""


def _first_rows(path: Path, header: Header, count: int = 20) -> list[list[str]]:
    """Cells of the first rows, as text."""
    with path.open("rb") as file:
        file.seek(header.size)
        lines = [file.readline(1 << 16) for _ in range(count)]
    return [[_bare(c).decode("utf-8", "replace") for c in line.split(header.separator)] for line in lines if line]


def _pick(path: Path, header: Header, wanted: Sequence[str], optional: Sequence[str]) -> dict[str, int]:
    names, row = header.names, f"{path}, row {header.line}"
    for name in (*wanted, *optional):
        if names.count(name) > 1:
            raise InputError(f"{row}: column {name} appears {names.count(name)} times, expected once")
    for name in wanted:
        if name not in names:
            raise InputError(f"{row}: no column {name}{known_names_hint(name, names)}")
    return {name: names.index(name) for name in (*wanted, *optional) if name in names}


def _scan(path: Path) -> tuple[str, int]:
    """Hash and number of lines."""
    digest, lines, last = hashlib.sha256(), 0, b""
    with path.open("rb") as file:
        while block := file.read(BLOCK_BYTES):
            digest.update(block)
            lines += block.count(b"\n")
            last = block
    return digest.hexdigest(), lines + (not last.endswith(b"\n"))


def _blocks(path: Path, header: Header) -> Iterator[bytes]:
    """Whole lines, about ``BLOCK_BYTES`` bytes at a time, with commas between columns and decimal points."""
    with path.open("rb") as file:
        file.seek(header.size)
        rest = b""
        while block := file.read(BLOCK_BYTES):
            cut = block.rfind(b"\n") + 1
            if cut:
                yield with_commas(rest + block[:cut], header.separator)
                rest = block[cut:]
            else:
                rest += block
            if len(rest) > BLOCK_BYTES:
                raise InputError(f"{path}: a line is longer than {BLOCK_BYTES >> 20} MiB, expected one sample a line")
        if rest:
            yield with_commas(rest, header.separator)


def _parse(
    path: Path, block: bytes, header: list[str], picked: dict[str, int], line: int
) -> tuple[FloatArray, list[int], int]:
    """Picked values of shape (rows, columns), the numbers of blank lines, and how many lines the block has."""
    if not block.endswith(b"\n"):
        block += b"\n"
    values = _parse_bulk(block, len(header))
    if values is not None:
        return values[:, list(picked.values())], [], len(values)
    return _parse_cells(path, block, header, picked, line)


def _parse_bulk(block: bytes, width: int) -> FloatArray | None:
    """Values of a block of plain numbers and empty cells; None if anything in it needs a closer look."""
    raw = np.frombuffer(block, dtype=np.uint8)
    if not IS_PLAIN_BYTE[raw].all():
        return None
    if b"\r" in block:
        block = block.replace(b"\r\n", b"\n")
        raw = np.frombuffer(block, dtype=np.uint8)
    marks = np.flatnonzero((raw == 44) | (raw == 10))
    if len(marks) % width:
        return None
    ends = raw[marks].reshape(-1, width) == 10
    if not ends[:, -1].all() or ends[:, :-1].any():
        return None
    if (len(marks) > 1 and (np.diff(marks) == 1).any()) or marks[0] == 0:
        block = re.sub(rb"(?:^|(?<=[,\n]))(?=[,\n])", b"nan", block)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            values = np.fromstring(block.replace(b"\n", b",")[:-1], sep=",")
        except (ValueError, DeprecationWarning):
            return None
    if values.size != len(marks) or np.isinf(values).any():
        return None
    return values.reshape(-1, width)


def _parse_cells(
    path: Path, block: bytes, header: list[str], picked: dict[str, int], line: int
) -> tuple[FloatArray, list[int], int]:
    """The same, cell by cell: decides what a number is and raises InputError where there is none."""
    rows: list[list[float]] = []
    blanks: list[int] = []
    lines = block[:-1].split(b"\n")
    time, *others = picked.items()
    for offset, text in enumerate(lines):
        if not text.strip(b" \t\r"):
            blanks.append(line + offset)
            continue
        cells = cells_of(text, len(header), header[-1])
        if len(cells) != len(header):
            noun = "cell" if len(cells) == 1 else "cells"
            raise InputError(
                f"{path}, row {line + offset}: {len(cells)} {noun}, expected {len(header)} "
                f"({_comma_hint(text) or ', '.join(header)})"
            )
        rows.append([_instant(path, line + offset, time[0], cells[time[1]])])
        rows[-1] += [_cell(path, line + offset, name, cells[position]) for name, position in others]
    return np.array(rows, dtype=float).reshape(-1, len(picked)), blanks, len(lines)


def _comma_hint(text: bytes) -> str:
    return "columns separated by commas, numbers with a decimal point" if b";" in text else ""


def _bare(cell: bytes) -> bytes:
    return cell.strip().strip(b'"').strip()


def _instant(path: Path, line: int, column: str, cell: bytes) -> float:
    """A time, or a date in s since 1970; without a zone it is taken for universal, which knows no hour twice."""
    text = _bare(cell)
    if not TIMESTAMP.fullmatch(text):
        if (clock := clock_seconds(text)) is not None:
            return clock
        if b":" in text:
            shown = text[:40].decode("utf-8", "replace")
            raise InputError(
                f"{path}, row {line}, column {column}: {shown!r} is not a number, a date like 2026-03-01T10:00:00.0 or "
                "a time of day like 10:00:00"
            )
        return _cell(path, line, column, cell)
    try:
        stamp = datetime.fromisoformat(text.decode())
    except ValueError:
        raise InputError(f"{path}, row {line}, column {column}: {text.decode()!r} is no date") from None
    return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()


def _cell(path: Path, line: int, column: str, cell: bytes) -> float:
    text = _bare(cell)
    if not text:
        return np.nan
    if THOUSANDS.fullmatch(text):
        text = text.replace(b",", b"")
    if NUMBER.fullmatch(text):
        value = float(text)
        if np.isfinite(value):
            return value
    if text.lower() in SWITCHED:
        return SWITCHED[text.lower()]
    shown = text[:40].decode("utf-8", "replace")
    if SPECIAL.fullmatch(text) or NUMBER.fullmatch(text):
        raise InputError(
            f"{path}, row {line}, column {column}: {shown} is not a finite number (leave the cell of a missing "
            "output reading empty)"
        )
    raise InputError(f"{path}, row {line}, column {column}: {shown!r} is not a number")
