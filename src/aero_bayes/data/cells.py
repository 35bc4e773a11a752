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

#: Numbers as any program writes them, with marks between thousands and exponents of Fortran.
NUMBER = r"[+-]?(\d[\d.,]*|[.,]\d+)([eEdD][+-]?\d+)?"
#: Dates whose order is plain (2026-03-01, 01-Mar-26, 01.03.2026), and with slashes, whose order is not; times of day.
DATE = r"\d{4}-\d\d-\d\d|\d{1,2}-[A-Za-z]{3}-(\d{4}|\d\d)|\d{1,2}\.\d{1,2}\.(\d{4}|\d\d)"
DATE += r"|\d{4}/\d{1,2}/\d{1,2}|\d{1,2}/\d{1,2}/(\d{4}|\d\d)"
CLOCK = r"\d{1,3}:\d\d(:\d\d([.,]\d*)?)?( ?[AaPp][Mm])?"
DATES = re.compile(rf"({DATE})([T ,]+{CLOCK})?(Z| ?[+-]\d\d:?\d\d)?")
CLOCKS = re.compile(r"(\d{1,3}):([0-5]\d):([0-5]\d(?:[.,]\d*)?)")
VALUE = re.compile(rf"{NUMBER}|[+-]?(nan|inf)|{CLOCK}|{DATES.pattern}", re.IGNORECASE)
#: Numbers with commas between thousands.
THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?")
#: What stands for no reading beside what pandas knows (NaN, N/A, null ...): loggers, German Excel, Visual C.
NO_READING = ["NAN", "Nan", "#NV", "#WERT!", "#VALUE!", "#DIV/0!", "1.#QNAN", "-1.#IND", "1.#IND"]
SWITCHED = {"true": 1.0, "false": 0.0}
DAY = 86400.0
#: Units of a count since 1970 by its least size, and the range of years 2001 to 2100 in seconds.
EPOCH_UNITS = ((1e18, 1e-9), (1e15, 1e-6), (1e12, 1e-3))
EPOCH_RANGE = (0.98e9, 4.1e9)
#: Days of a spreadsheet in the years 1990 to 2090, and the longest step that is taken for a share of a day.
SPREADSHEET_DAYS, MAX_DAY_STEP = (32874.0, 69763.0), 1.0
#: Where a cell stands: "FILE, row 7".
Place = Callable[[int], str]


def is_value(cell: str) -> bool:
    """Return whether a cell of text is a number, a date or a time rather than a word."""
    return VALUE.fullmatch(cell) is not None


def numbers_in(column: pandas.Series, place: Place, name: str) -> FloatArray:
    """Convert cells of a column to numbers, NaN where one is empty."""
    import pandas

    if column.dtype.kind in "biuf":
        return numbers(column, name)
    if column.dtype.kind in "mM":
        raise InputError(f"{place(0)}, column {name}: holds dates or durations, expected numbers")
    cells = column.astype(object).map(_plain_cell)
    found = np.asarray(pandas.to_numeric(cells, errors="coerce"), dtype=np.float64)
    wrong = np.isnan(found) & cells.notna().to_numpy()
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(f"{place(row)}, column {name}: {str(cells.iloc[row])[:40]!r} is not a number")
    return found


def _plain_cell(cell: Any) -> Any:
    """Return a cell with what pandas does not read as a number put plainly."""
    if not isinstance(cell, str):
        return cell
    text = cell.strip(' "\t')
    if THOUSANDS.fullmatch(text):
        text = text.replace(",", "")
    text = re.sub(r"(?<=[\d.])[dD](?=[+-]?\d)", "e", text)
    if not text or text in ("<NA>", *NO_READING):
        return None
    return SWITCHED.get(text.lower(), text)


def times_in(column: pandas.Series, place: Place, name: str) -> tuple[FloatArray, float]:
    """Convert cells to times in s, and what was taken off them: times of day over midnight, dates from the first one.

    A date without a zone is taken for universal time, which knows no hour twice."""
    if column.dtype.kind in "biufmM":
        return instants(column)
    text = [str(cell).strip(' "\t') for cell in column]
    clocks = [CLOCKS.fullmatch(cell) for cell in text]
    if all(clocks):
        parts = np.array([[float(p.replace(",", ".")) for p in c.groups()] for c in clocks if c])
        time = parts @ (3600.0, 60.0, 1.0)
        return time + DAY * np.concatenate(([0.0], np.cumsum(np.diff(time) < -0.5 * DAY))), 0.0  # over midnight
    if (":" not in text[0] and not re.fullmatch(DATE, text[0])) or isinstance(column.iloc[0], int | float):
        return numbers_in(column, place, name), 0.0
    for row, cell in enumerate(text):
        if not DATES.fullmatch(cell):
            raise InputError(f"{place(row)}, column {name}: {cell[:40]!r} is not a number, a date like "
                             "2026-03-01T10:00:00.0 or a time of day like 10:00:00")  # fmt: skip
    return _dates_in(text, place, name)


def _dates_in(text: list[str], place: Place, name: str) -> tuple[FloatArray, float]:
    """Convert dates to s; of day and month in dates with slashes, in that order in which the time goes on steadily."""
    import pandas

    plain = pandas.Series(text).str.replace(r"(?<=\d),(?=\d)", ".", regex=True)
    plain = plain.str.replace(r"[T ,]+(?=\d\d?:)", " ", regex=True).str.replace(r" ?([AaPp][Mm])", r" \1", regex=True)
    year_first, slashes = re.match(r"\d{4}", text[0]), "/" in text[0].partition(" ")[0]
    orders = [not year_first]
    if slashes and not year_first:
        orders = [False] if re.search("[AaPp][Mm]", text[0]) else [False, True]
    form = "mixed" if slashes or not year_first else "ISO8601"
    read = [pandas.to_datetime(plain, format=form, dayfirst=day, utc=True, errors="coerce") for day in orders]
    best = min(read, key=lambda dates: (dates.isna().any(), dates.diff().abs().max()))
    if best.isna().any():
        row = int(np.argmax(best.isna()))
        raise InputError(f"{place(row)}, column {name}: {text[row]!r} is no date")
    return instants(best)


def seconds(times: Any) -> FloatArray:
    """Convert a series or an index of pandas, or an array, to times in s."""
    return instants(times)[0]


def instants(times: Any) -> tuple[FloatArray, float]:
    """Convert times of pandas or an array to s, and return what was taken off them.

    Dates count from the first one, whatever their resolution and time zone; durations and numbers stay what they are.
    """
    import pandas

    given = pandas.Series(times.array if hasattr(times, "array") else times)
    if isinstance(given.dtype, pandas.PeriodDtype):
        given = given.dt.to_timestamp()
    first = given.iloc[0] if len(given) else 0.0
    if given.dtype == object and not isinstance(first, int | float | np.number):
        try:
            if hasattr(first, "total_seconds"):
                given = pandas.Series(pandas.to_timedelta(given))
            else:  # text with several offsets is compared by the instants that it names
                form = "ISO8601" if isinstance(first, str) else None
                given = pandas.Series(pandas.to_datetime(given, utc=True, format=form))
        except (ValueError, TypeError, OverflowError):
            pass  # refused below
    origin = 0.0
    if given.dtype.kind == "M":
        origin = given.iloc[0].timestamp()
        given = given - given.iloc[0]
    if given.dtype.kind == "m":
        given = given / pandas.Timedelta(seconds=1)
    return numbers(given, "time"), origin


def numbers(values: Any, where: str, name: str = "time") -> FloatArray:
    """Return a column as numbers, NaN where there is none; InputError for dates, durations and text."""
    try:
        if getattr(getattr(values, "dtype", None), "kind", "f") in "mM":
            raise TypeError
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: column {name} holds something else than numbers") from None


def plain_seconds(time: FloatArray) -> tuple[FloatArray, float]:
    """Count times in s from the first one, where they are ms or less since 1970, or days of a spreadsheet.

    A step of a spreadsheet is a whole number of seconds, but as a share of a day no short number. What was taken off
    the times is returned, too."""
    if time.size < 2 or not np.isfinite(time).all():
        return time, 0.0
    for least, unit in EPOCH_UNITS:
        if least * 1e-3 < time[0] and EPOCH_RANGE[0] < time[0] * unit < EPOCH_RANGE[1]:
            return np.asarray((time - time[0]) * unit), float(time[0] * unit)
    step = float(np.median(np.diff(time)))
    if SPREADSHEET_DAYS[0] < time[0] and time[-1] < SPREADSHEET_DAYS[1] and 0.0 < step < MAX_DAY_STEP:
        seconds_of_step = step * DAY
        whole = abs(seconds_of_step - round(seconds_of_step)) < 0.01 and seconds_of_step > 0.5
        short = abs(step * 1e3 - round(step * 1e3)) < 1e-4
        if whole and not short:
            return np.asarray(np.round((time - time[0]) * DAY, 3)), float(time[0] * DAY)
    return time, 0.0
