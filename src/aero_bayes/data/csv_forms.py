"""Forms of text files other than plain CSV: what loggers and spreadsheets write, and how it is read or refused."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import InputError

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

LABVIEW, END_OF_HEADER = b"LabVIEW Measurement", b"***End_of_Header***"
#: First line of a file for a spreadsheet that says what separates its columns.
SEPARATOR_LINE = re.compile(rb"\s*sep=(.)\s*", re.IGNORECASE)
#: A time of day, with seconds.
CLOCK = re.compile(rb"(\d{1,3}):([0-5]\d):([0-5]\d(?:[.,]\d*)?)")
#: Numbers with marks between thousands, of which there are none in a fraction.
THOUSANDS = re.compile(rb"[+-]?\d{1,3}(,\d{3})+(\.\d*)?")
#: A thousands' point before a decimal comma, in a file whose decimal mark is a comma.
POINT_AND_COMMA = re.compile(rb"\d\.\d{3},\d")
FORTRAN = re.compile(rb"([\d.])[dD]([+-]?\d)")
DAY = 86400.0
#: Units of a count since 1970 by its least size, and the range of years 2001 to 2100 in seconds.
EPOCH_UNITS = ((1e18, 1e-9), (1e15, 1e-6), (1e12, 1e-3))
EPOCH_RANGE = (0.98e9, 4.1e9)
#: Days of a spreadsheet in the years 1990 to 2090, and the longest step that is taken for a share of a day.
SPREADSHEET_DAYS, MAX_DAY_STEP = (32874.0, 69763.0), 1.0
#: How a column is called that says of each row (or of one signal) whether it is good.
QUALITY_NAMES = ("quality", "dataquality", "status", "validity", "flag", "q")
#: Words for a reading that is none.
BAD_WORDS = re.compile(
    r"bad|invalid|uncertain|err|fail|fault|offline|no.?data|not.?connected|questionable|\bnok\b", re.I
)


def skipped_preamble(lines: Sequence[bytes]) -> int:
    """Number of lines above the header that a spreadsheet or LabVIEW writes."""
    if lines and lines[0].lstrip(b"\xef\xbb\xbf").startswith(LABVIEW):
        return max((k + 1 for k, line in enumerate(lines) if line.strip().startswith(END_OF_HEADER)), default=1)
    return 1 if lines and SEPARATOR_LINE.fullmatch(lines[0].lstrip(b"\xef\xbb\xbf")) else 0


def with_commas(block: bytes, separator: bytes) -> bytes:
    """A block of lines with commas between columns and decimal points."""
    if separator == b" ":
        block = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", block)
        return FORTRAN.sub(rb"\1e\2", re.sub(rb"[ \t]+", b",", block))
    if separator != b",":
        pointed = b"." if POINT_AND_COMMA.search(block) else None
        block = block.translate(bytes.maketrans(b"," + separator, b".,"), pointed or b"")
    return block


def cells_of(line: bytes, width: int, last: str) -> list[bytes]:
    """Cells of a line; quoted ones may hold a comma, and LabVIEW leaves out an empty comment at the end."""
    cells = line.split(b",")
    if len(cells) > width and b'"' in line:
        cells = [cell.encode() for cell in next(csv.reader([line.decode("utf-8", "replace")]))]
    return [*cells, b""] if len(cells) == width - 1 and last == "Comment" else cells


def clock_seconds(text: bytes) -> float | None:
    """A time of day in s; None for what is none."""
    found = CLOCK.fullmatch(text)
    if found is None:
        return None
    hours, minutes, seconds = (float(part.replace(b",", b".")) for part in found.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


def after_midnight(time: FloatArray) -> FloatArray:
    """Times of day that go on over midnight."""
    return time + DAY * np.concatenate(([0.0], np.cumsum(np.diff(time) < -0.5 * DAY)))


def plain_seconds(time: FloatArray) -> FloatArray:
    """Times in s, from the first one on where they count ms or less since 1970, or are days of a spreadsheet.

    A step of a spreadsheet is a whole number of seconds, but as a share of a day no short number.
    """
    if time.size < 2 or not np.isfinite(time).all():
        return time
    for least, unit in EPOCH_UNITS:
        if least * 1e-3 < time[0] and EPOCH_RANGE[0] < time[0] * unit < EPOCH_RANGE[1]:
            return np.asarray((time - time[0]) * unit)
    step = float(np.median(np.diff(time)))
    if SPREADSHEET_DAYS[0] < time[0] and time[-1] < SPREADSHEET_DAYS[1] and 0.0 < step < MAX_DAY_STEP:
        seconds = step * DAY
        whole = abs(seconds - round(seconds)) < 0.01 and seconds > 0.5
        short = abs(step * 1e3 - round(step * 1e3)) < 1e-4
        if whole and not short:
            return np.asarray(np.round((time - time[0]) * DAY, 3))
    return time


def check_layout(where: str, names: Sequence[str], wanted: Sequence[str], first_rows: Sequence[Sequence[str]]) -> None:
    """Refuse a file with one reading a row, and one whose signals have clocks of their own.

    Raises
    ------
    InputError
        One line that says what to do.
    """
    missing = [name for name in wanted if name not in names]
    for column, name in enumerate(names):
        cells = {row[column] for row in first_rows if column < len(row)}
        if missing and cells & set(missing):
            raise InputError(
                f"{where}: one reading a row, whose signal column {name} names; expected one column a signal and one "
                f"row a time: reshape it, e.g. by pandas: frame.pivot(columns={name!r}, ...)"
            )
    clocks = [name for name in names if re.fullmatch(r"(?i)(time|t|timestamp)[ _-].+", name)]
    own = [n for n in clocks if re.split(r"[ _-]", n, maxsplit=1)[1] in {*names}]
    if len(own) > 1:
        raise InputError(
            f"{where}: columns {' and '.join(own)} are clocks of single signals, expected one time a row: resample the "
            "signals to common times"
        )


def quality_columns(names: Sequence[str], signals: Mapping[str, str]) -> dict[str, list[str]]:
    """The signals that each column of quality words is about, by the column's name.

    ``signals`` has the column of each signal. A column that names no signal is about all of them.
    """

    def plain(text: str) -> str:
        return re.sub(r"[\W_]", "", text.casefold())

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


def bad_rows(path: Path, lines: Iterator[bytes], column: int, rows: int) -> Mask:
    """Rows whose cell of quality says that the reading is none.

    Parameters
    ----------
    path : Path
        For messages.
    lines : iterator of bytes
        Lines with data, blank ones left out.
    column : int
    rows : int
        How many there are.
    """
    bad = np.zeros(rows, dtype=bool)
    for row, line in enumerate(lines):
        if row >= rows:
            raise InputError(f"{path}: changed while it was read")
        cells = line.split(b",")
        word = cells[column].strip().strip(b'"').decode("utf-8", "replace") if column < len(cells) else ""
        bad[row] = bool(BAD_WORDS.search(word))
    return bad
