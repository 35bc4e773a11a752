"""What a cell of a table says: a number, a time, a date, a switch, or nothing."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError

if TYPE_CHECKING:
    import pandas

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
SPECIAL = re.compile(r"[+-]?(nan|inf|infinity|1\.#\w+)", re.IGNORECASE)
TIMESTAMP = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?")
#: Dates as historians and German programs write them, whose order of day and month is plain: 01-Mar-26, 01.03.2026.
NAMED_MONTH = re.compile(r"(\d{1,2})-([A-Za-z]{3})-(\d{2}|\d{4})[T ](\d\d:.*)")
DOTTED_DATE = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4}),? (\d\d:.*)")
MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
#: A time of day, with seconds.
CLOCK = re.compile(r"(\d{1,3}):([0-5]\d):([0-5]\d(?:[.,]\d*)?)")
#: Numbers with marks between thousands, of which there are none in a fraction.
THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?")
#: An exponent as Fortran writes it.
FORTRAN = re.compile(r"([\d.])[dD]([+-]?\d)")
#: Cells of a switch.
SWITCHED = {"true": 1.0, "false": 0.0}
DAY = 86400.0
#: Units of a count since 1970 by its least size, and the range of years 2001 to 2100 in seconds.
EPOCH_UNITS = ((1e18, 1e-9), (1e15, 1e-6), (1e12, 1e-3))
EPOCH_RANGE = (0.98e9, 4.1e9)
#: Days of a spreadsheet in the years 1990 to 2090, and the longest step that is taken for a share of a day.
SPREADSHEET_DAYS, MAX_DAY_STEP = (32874.0, 69763.0), 1.0
#: Where a cell stands: "FILE, row 7".
Place = Callable[[int], str]


def is_number(cell: str) -> bool:
    """Return whether a cell of text is a number or a date rather than a name."""
    return any(form.fullmatch(cell) for form in (NUMBER, SPECIAL, TIMESTAMP, CLOCK))


def numbers_in(column: pandas.Series, place: Place, name: str) -> FloatArray:
    """Convert cells of a column to numbers, NaN where one is empty."""
    if column.dtype.kind in "biuf":
        return np.asarray(column.to_numpy(), dtype=np.float64)
    if column.dtype.kind in "mM":
        raise InputError(f"{place(0)}, column {name}: holds dates or durations, something else than numbers")
    return np.array([_number(cell, place, row, name) for row, cell in enumerate(column)], dtype=np.float64)


def times_in(column: pandas.Series, place: Place, name: str) -> FloatArray:
    """Convert cells to times in s: numbers as they are, times of day over midnight, dates from the first one on.

    A date without a zone is taken for universal time, which knows no hour twice."""
    if column.dtype.kind in "biuf":
        return np.asarray(column.to_numpy(), dtype=np.float64)
    if column.dtype.kind in "mM":
        return seconds(column)
    text = [str(cell).strip().strip('"').strip() for cell in column]
    if NAMED_MONTH.fullmatch(text[0]) or DOTTED_DATE.fullmatch(text[0]):
        text = [_iso_date(cell) for cell in text]
    clocks = [CLOCK.fullmatch(cell) for cell in text]
    if all(clocks):
        parts = np.array([[float(p.replace(",", ".")) for p in c.groups()] for c in clocks if c])
        return _after_midnight(parts @ (3600.0, 60.0, 1.0))
    if TIMESTAMP.fullmatch(text[0]):
        for row, cell in enumerate(text):
            if not TIMESTAMP.fullmatch(cell):
                raise InputError(f"{place(row)}, column {name}: {cell[:40]!r} is no date as those above it are")
        return _dates_in(text, place, name)
    for row, cell in enumerate(text):
        if ":" in cell and not isinstance(column.iloc[row], int | float):
            raise InputError(
                f"{place(row)}, column {name}: {cell[:40]!r} is not a number, a date like 2026-03-01T10:00:00.0 or a "
                "time of day like 10:00:00"
            )
    return numbers_in(column, place, name)


def _iso_date(cell: str) -> str:
    """Return a date with its month's name, or with points, as ISO 8601 has it; another cell as it is."""
    if (found := NAMED_MONTH.fullmatch(cell)) and found[2].lower() in MONTHS:
        year = found[3] if len(found[3]) == 4 else f"20{found[3]}"
        return f"{year}-{MONTHS.index(found[2].lower()) + 1:02d}-{int(found[1]):02d} {found[4]}"
    if found := DOTTED_DATE.fullmatch(cell):
        return f"{found[3]}-{int(found[2]):02d}-{int(found[1]):02d} {found[4]}"
    return cell


def _dates_in(text: list[str], place: Place, name: str) -> FloatArray:
    import pandas

    instants = pandas.to_datetime(
        [cell.replace(",", ".") for cell in text], format="ISO8601", utc=True, errors="coerce"
    )
    if instants.isna().any():
        row = int(np.argmax(instants.isna()))
        raise InputError(f"{place(row)}, column {name}: {text[row]!r} is no date")
    return seconds(pandas.Series(instants))


def seconds(times: Any) -> FloatArray:
    """Convert a series or an index of pandas, or an array, to times in s.

    Dates count from the first one, whatever their resolution and time zone; durations and numbers stay what they are.
    """
    import pandas

    given = pandas.Series(times.array if hasattr(times, "array") else times)
    if isinstance(given.dtype, pandas.PeriodDtype):
        given = given.dt.to_timestamp()
    if given.dtype == object and len(given) and not isinstance(given.iloc[0], int | float | np.number):
        first = given.iloc[0]
        by = pandas.to_timedelta if hasattr(first, "total_seconds") else _dates
        try:
            given = pandas.Series(by(given))
        except (ValueError, TypeError, OverflowError):
            return numbers(given, "time")
    if isinstance(given.dtype, pandas.DatetimeTZDtype):
        given = given.dt.tz_convert("UTC").dt.tz_localize(None)
    if given.dtype.kind == "M":
        given = given - given.iloc[0]
    if given.dtype.kind == "m":
        return np.asarray(given / pandas.Timedelta(seconds=1), dtype=np.float64)
    return numbers(given, "time")


def numbers(column: Any, where: str) -> FloatArray:
    """Return a column as numbers, NaN where there is none; InputError for dates, durations and text."""
    name = getattr(column, "name", None) or "time"
    kind = getattr(getattr(column, "dtype", None), "kind", "f")
    try:
        if kind in "mM":
            raise TypeError
        return np.asarray(column, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: column {name} holds something else than numbers") from None


def plain_seconds(time: FloatArray) -> FloatArray:
    """Count times in s from the first one, where they are ms or less since 1970, or days of a spreadsheet.

    A step of a spreadsheet is a whole number of seconds, but as a share of a day no short number."""
    if time.size < 2 or not np.isfinite(time).all():
        return time
    for least, unit in EPOCH_UNITS:
        if least * 1e-3 < time[0] and EPOCH_RANGE[0] < time[0] * unit < EPOCH_RANGE[1]:
            return np.asarray((time - time[0]) * unit)
    step = float(np.median(np.diff(time)))
    if SPREADSHEET_DAYS[0] < time[0] and time[-1] < SPREADSHEET_DAYS[1] and 0.0 < step < MAX_DAY_STEP:
        seconds_of_step = step * DAY
        whole = abs(seconds_of_step - round(seconds_of_step)) < 0.01 and seconds_of_step > 0.5
        short = abs(step * 1e3 - round(step * 1e3)) < 1e-4
        if whole and not short:
            return np.asarray(np.round((time - time[0]) * DAY, 3))
    return time


def _dates(values: Any) -> Any:
    """Convert dates to universal time; text with several offsets is compared by the instants that it names."""
    import pandas

    text = isinstance(values.iloc[0], str)
    return pandas.to_datetime(values, utc=True, **({"format": "ISO8601"} if text else {}))


def _after_midnight(time: FloatArray) -> FloatArray:
    """Let times of day go on over midnight."""
    return time + DAY * np.concatenate(([0.0], np.cumsum(np.diff(time) < -0.5 * DAY)))


def _number(cell: Any, place: Place, row: int, name: str) -> float:
    if cell is None or isinstance(cell, bool | int | float | np.number | np.bool_):
        return np.nan if cell is None else float(cell)
    text = str(cell).strip().strip('"').strip()
    if not text or text == "<NA>":
        return np.nan
    if THOUSANDS.fullmatch(text):
        text = text.replace(",", "")
    text = FORTRAN.sub(r"\1e\2", text)
    if NUMBER.fullmatch(text) and np.isfinite(value := float(text)):
        return value
    if text.lower() in SWITCHED:
        return SWITCHED[text.lower()]
    if SPECIAL.fullmatch(text) or NUMBER.fullmatch(text):
        raise InputError(
            f"{place(row)}, column {name}: {text[:40]} is not a finite number (leave the cell of a missing output "
            "reading empty)"
        )
    raise InputError(f"{place(row)}, column {name}: {text[:40]!r} is not a number")
