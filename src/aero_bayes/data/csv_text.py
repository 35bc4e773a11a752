"""Tables of text: what separates their columns, where their header stands, and their cells through pandas.

Columns are separated by commas, by semicolons or tabs, where a comma is a decimal mark, or by spaces. Lines that begin
with ``#`` or ``%`` may stand above the header, a line of units below it (``F`` is then called ``F [N]``). A line that
has not as many cells as the header is refused with its number. What a cell says is decided in
:mod:`aero_bayes.data.cells`.
"""

from __future__ import annotations

import csv
import hashlib
import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aero_bayes.data.cells import FORTRAN, NUMBER, is_number
from aero_bayes.data.table import FileTable
from aero_bayes.errors import InputError

if TYPE_CHECKING:
    import pandas

SEPARATORS = (",", ";", "\t")
COMMENTS = (b"#", b"%")
#: First line of a file for a spreadsheet that says what separates its columns.
SEPARATOR_LINE = re.compile(rb"(?:\xef\xbb\xbf)?\s*sep=(.)\s*", re.IGNORECASE)
#: A thousands' point before a decimal comma, in a file whose decimal mark is a comma.
POINT_AND_COMMA = re.compile(rb"\d\.\d{3},\d")
#: Version of pandas that reads every number exactly without being asked.
EXACT_SINCE = (3, 1)
#: Bytes that a line may have.
MAX_LINE = 8 << 20
#: Bytes that pandas takes for a value while it reads, and for anything at all.
BYTES_PER_VALUE, LEAST_BYTES = 24, 64 << 20


@dataclass(frozen=True)
class Header:
    """Names of a file's columns, what separates them, the line they stand in, and the bytes up to its end."""

    names: list[str]
    separator: str
    line: int
    size: int


@dataclass(frozen=True)
class Scan:
    """What one look at all lines tells: hash, lines of data, blank lines, and the marks in numbers."""

    sha256: str
    rows: int
    blanks: tuple[int, ...]
    decimal_comma: bool
    thousands: bool

    def line(self, row: int, first: int) -> int:
        """Return the line of the file, counted from 1, that holds row ``row``, the first being ``first``."""
        line = row + first
        for blank in self.blanks:
            if blank > line:
                break
            line += 1
        return line


class TextTable:
    """A table of text whose columns are read when they are asked for."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.header = read_header(path)
        self.names = self.header.names
        self.where = f"{path}, row {self.header.line}"

    def head(self) -> pandas.DataFrame:
        """Return the first rows, as text."""
        return self._frame(range(len(self.names)), Scan("", 20, (), False, False), dtype=str, nrows=20)

    def read(self, columns: Sequence[str], memory: int | None = None) -> FileTable:
        """Read columns by name; InputError for lines with too few or too many cells, and for too little memory."""
        scan = _scan(self.path, self.header)
        if scan.rows == 0:
            raise InputError(f"{self.path}: holds a header but no data, expected one sample a line")
        needed = BYTES_PER_VALUE * scan.rows * len(columns) + LEAST_BYTES
        free = memory if memory is not None else free_memory()
        if needed > free:
            raise InputError(
                f"{self.path}: {scan.rows:,} rows of {len(columns)} columns need {needed / 2**20:,.0f} MiB of memory, "
                f"{free / 2**20:,.0f} MiB are free: thin or cut the file, or run on a larger machine"
            )
        places = [self.names.index(name) for name in columns]
        frame = self._frame(places, scan, skipinitialspace=True, na_values=[""])
        # Text, switches, and numbers that are not finite are read again as they stand.
        odd = [p for p in places if frame[p].dtype.kind not in "iuf" or not np.isfinite(frame[p]).all()]
        if odd:
            text = self._frame(odd, scan, dtype=str)
            for place in odd:
                frame[place] = _as_it_stands(frame[place], text[place], scan, self.header.separator)
        first = self.header.line + 1
        frame = frame.set_axis([self.names[place] for place in frame.columns], axis=1)
        return FileTable(frame, scan.sha256, lambda row: f"row {scan.line(row, first)}", scan.line(0, first))

    def _frame(self, places: Sequence[int], scan: Scan, **options: Any) -> pandas.DataFrame:
        import pandas

        separator = self.header.separator
        options |= {"decimal": ","} if scan.decimal_comma else {}
        if tuple(map(int, pandas.__version__.split(".")[:2])) < EXACT_SINCE:
            options["float_precision"] = "round_trip"
        options |= {"keep_default_na": False, "encoding_errors": "replace"}
        options |= {} if "nrows" in options else {"usecols": sorted(places)}
        for quoting in (csv.QUOTE_MINIMAL, csv.QUOTE_NONE):
            with self.path.open("rb") as file, warnings.catch_warnings():
                warnings.simplefilter("ignore", pandas.errors.ParserWarning)  # the number of cells was checked
                file.seek(self.header.size)
                frame: pandas.DataFrame = pandas.read_csv(
                    file, sep=r"\s+" if separator == " " else separator, header=None, names=range(len(self.names)),
                    index_col=False, low_memory=False, encoding="utf-8", quoting=quoting,
                    on_bad_lines="skip", **options,
                )  # fmt: skip
            if len(frame) == scan.rows or "nrows" in options:
                return frame
        raise InputError(f"{self.path}: changed while it was read, or has line breaks inside quotes")


def _as_it_stands(values: pandas.Series, text: pandas.Series, scan: Scan, separator: str) -> pandas.Series:
    """Read cells of text with decimal points; values where all that are no number are empty cells."""
    if values.dtype.kind == "f":
        missing = ~np.isfinite(values.to_numpy())
        if not text[missing].str.strip().str.strip('"').str.strip().astype(bool).any():
            return values
    if separator != "," and scan.decimal_comma:
        text = text.str.replace(".", "", regex=False) if scan.thousands else text
        return text.str.replace(",", ".", regex=False)
    return text


def free_memory() -> int:
    """Count the bytes that this process may still take: what the system has, and its control group's limit."""
    try:
        free = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES")
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free = int(line.split()[1]) * 1024
    except (OSError, ValueError, AttributeError):
        free = 1 << 30
    try:
        limit = int(Path("/sys/fs/cgroup/memory.max").read_text())
        used = int(Path("/sys/fs/cgroup/memory.current").read_text())
        free = min(free, max(limit - used, 0))
    except (OSError, ValueError):
        pass
    return free


def read_header(path: Path) -> Header:
    """Return names and layout of a file's columns."""
    raw, last, line, size = b"", b"", 0, 0
    with path.open("rb") as file:
        raw = file.readline(1 << 20)
        line, size = 1, len(raw)
        above = int(bool(SEPARATOR_LINE.fullmatch(raw)))
        while (line == above and raw) or raw.lstrip(b"\xef\xbb\xbf \t").startswith(COMMENTS):
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
        separator, names = " ", names[0].split()
    if _are_numbers(names):
        raise InputError(f"{path}, row {line}: holds numbers, expected a header such as time,u,y")
    shown = FORTRAN.sub(r"\1e\2", below.decode("utf-8", "replace"))
    units = [cell.strip().strip('"').strip() for cell in (shown.split(None if separator == " " else separator))]
    if len(units) == len(names) > 1 and any(units) and not any(is_number(u.replace(",", ".")) for u in units):
        names, line, size = with_units(names, units), line + 1, size + len(below)
    header = Header(names, separator, line, size)
    # Lines that tell of a measurement may stand above its names, as dSPACE and oscilloscopes write them.
    if any(map(_is_plain_number, names)) and not all(names[:-1]):
        raise InputError(f"{path}, row {line}: names, numbers and empty cells; delete what is above the columns' names")
    if separator != " " and below.strip():  # a line of units has as many cells, and is part of the header
        _check_width(f"{path}, row {line + 1}", below, header)
    return header


def _is_plain_number(cell: str) -> bool:
    return bool(cell) and bool(NUMBER.fullmatch(cell))


def with_units(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return names of columns with the units of the line below them: ``F [N]``."""
    return [n + (f" [{u.strip('[]() ')}]" if u.strip("[]() ") else "") for n, u in zip(names, units, strict=True)]


def _split(text: str) -> tuple[str, list[str]]:
    """Return what separates the names of a header, and the names."""
    separator = max(SEPARATORS, key=text.count)
    names = next(csv.reader([text.strip("\r\n ")], delimiter=separator, skipinitialspace=True), [""])
    return separator, [name.strip().strip('"').strip() for name in names]


def _are_numbers(names: list[str]) -> bool:
    return all(NUMBER.fullmatch(name.replace(",", ".")) for name in names if name)


def _scan(path: Path, header: Header) -> Scan:
    """Look at all lines; InputError for the first that has not as many cells as the header."""
    digest, rows, blanks, comma, thousands = hashlib.sha256(), 0, [], False, False
    separator, width = header.separator.encode(), len(header.names)
    with path.open("rb") as file:
        number = 0
        while raw := file.readline(MAX_LINE):
            digest.update(raw)
            number += 1
            if number <= header.line:
                continue
            if len(raw) == MAX_LINE:
                raise InputError(f"{path}: a line is longer than {MAX_LINE >> 20} MiB, expected one sample a line")
            if raw.isspace():
                blanks.append(number)
                continue
            rows += 1
            cells = len(raw.split()) if separator == b" " else raw.count(separator) + 1
            if cells != width:
                _check_width(f"{path}, row {number}", raw, header)
            if separator != b"," and b"," in raw:
                comma = True
                thousands = thousands or bool(POINT_AND_COMMA.search(raw))
    return Scan(digest.hexdigest(), rows, tuple(blanks), comma, thousands)


def _check_width(where: str, raw: bytes, header: Header) -> None:
    text = raw.decode("utf-8", "replace").strip("\r\n")
    cells = text.split() if header.separator == " " else next(csv.reader([text], delimiter=header.separator))
    if len(cells) != len(header.names):
        noun = "cell" if len(cells) == 1 else "cells"
        marks = "columns separated by commas, numbers with a decimal point" if ";" in text else ""
        raise InputError(
            f"{where}: {len(cells)} {noun}, expected {len(header.names)} ({marks or ', '.join(header.names)})"
        )
