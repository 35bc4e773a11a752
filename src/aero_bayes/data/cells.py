"""What a cell of a table says: a number, a time, a date, a switch, or nothing."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.modelica.units import is_unit, to_modelica_unit, unit_written_out

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
#: A number with something behind it that may be its unit: ``12.5 degC``, ``45%``; but ``3V3`` is a name.
MEASURED = re.compile(rf"(?P<number>{NUMBER})(?P<unit>\s+([^\W\d_]|[%°]).*|([^\W\d_]|[%°])\D*)")
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
#: Share of the steps of time that run backwards where the newest row stands on top.
MOSTLY_BACK = 0.9


def is_value(cell: str) -> bool:
    """Return whether a cell of text is a number, a date or a time rather than a word."""
    return VALUE.fullmatch(cell) is not None or bool(measured(cell)[1])


def measured(cell: str) -> tuple[str, str]:
    """Return a number without the unit behind it, and that unit; the cell and nothing where there is none."""
    found = MEASURED.fullmatch(cell.strip(' "'))
    unit = _unit(found["unit"].strip()) if found is not None else ""
    return (found["number"], unit) if found is not None and unit else (cell, "")


@lru_cache(maxsize=256)
def _unit(text: str) -> str:
    """Return a unit that is known; empty for another word."""
    plain = to_modelica_unit(text)
    return plain if is_unit(plain) else unit_written_out(text)


def numbers_and_unit(
    column: pandas.Series, where: str, name: str, words: Mapping[str, float] | None = None
) -> tuple[FloatArray, str]:
    """Convert cells of a column to numbers, NaN where one is empty; return the unit behind all of them, too.

    ``words`` are the names of some numbers; ``where`` is what a row is called, and its index numbers them."""
    import pandas

    if column.dtype.kind in "biuf":
        return numbers(column, name), ""
    if column.dtype.kind in "mM":
        raise InputError(f"{where} {column.index[0]}, column {name}: holds dates or durations, expected numbers")
    known = {word.casefold(): value for word, value in (words or {}).items()}
    cells, unit = column.astype(object).map(_plain_cell), ""
    if known:
        cells = cells.map(lambda c: known.get(c.rpartition(".")[2].casefold(), c) if isinstance(c, str) else c)
    found, there = np.asarray(pandas.to_numeric(cells, errors="coerce"), dtype=np.float64), cells.notna().to_numpy()
    wrong = np.isnan(found) & there
    if wrong.any() and (unit := measured(str(cells.iloc[int(np.argmax(there))]))[1]):
        parts = [measured(str(cell)) for cell in cells]
        plain = pandas.Series([_plain_cell(number) for number, _ in parts])
        found = np.where(there, pandas.to_numeric(plain, errors="coerce"), np.nan)
        wrong = (np.isnan(found) | np.array([own != unit for _, own in parts])) & there
    if wrong.any():
        row = int(np.argmax(wrong))
        expected = f", expected {', '.join(words)}" if words else f", expected one in {unit}" if unit else ""
        told = f"{where} {column.index[row]}, column {name}: {str(cells.iloc[row])[:40]!r} is not a number"
        raise InputError(f"{told}{expected}")
    return found, unit


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


def times_in(column: pandas.Series, where: str, name: str) -> tuple[FloatArray, float]:
    """Convert cells to times in s, and what was taken off: times of day over midnight, dates from the earliest.

    A date without a zone is taken for universal time, which knows no hour twice."""
    if column.dtype.kind in "biufmM":
        return instants(column)
    text = [str(cell).strip(' "\t') for cell in column]
    clocks = [CLOCKS.fullmatch(cell) for cell in text]
    if all(clocks):
        parts = np.array([[float(p.replace(",", ".")) for p in c.groups()] for c in clocks if c])
        time = parts @ (3600.0, 60.0, 1.0)
        turn = -1 if np.median(np.diff(time)) < 0.0 else 1  # the newest row first
        days = np.concatenate(([0.0], np.cumsum(np.diff(time[::turn]) < -0.5 * DAY)))  # over midnight
        return time + DAY * days[::turn], 0.0
    if (":" not in text[0] and not re.fullmatch(DATE, text[0])) or isinstance(column.iloc[0], int | float):
        time, unit = numbers_and_unit(column, where, name)
        if unit not in ("", "s"):
            raise InputError(f"{where} {column.index[0]}, column {name}: {text[0]!r} is in {unit}, expected plain "
                             "numbers, or seconds")  # fmt: skip
        return time, 0.0
    for row, cell in enumerate(text):
        if not DATES.fullmatch(cell):
            raise InputError(f"{where} {column.index[row]}, column {name}: {cell[:40]!r} is not a number, a date like "
                             "2026-03-01T10:00:00.0 or a time of day like 10:00:00")  # fmt: skip
    dates = _dates_in(text)
    if (none := dates.isna().to_numpy()).any():
        row = int(np.argmax(none))
        raise InputError(f"{where} {column.index[row]}, column {name}: {text[row]!r} is no date")
    return instants(dates)


def _dates_in(text: list[str]) -> pandas.Series:
    """Read dates; of day and month in dates with slashes, in that order in which the time goes on steadily."""
    import pandas

    plain = pandas.Series(text).str.replace(r"(?<=\d),(?=\d)", ".", regex=True)
    plain = plain.str.replace(r"[T ,]+(?=\d\d?:)", " ", regex=True).str.replace(r" ?([AaPp][Mm])", r" \1", regex=True)
    year_first, slashes = re.match(r"\d{4}", text[0]), "/" in text[0].partition(" ")[0]
    orders = [not year_first]
    if slashes and not year_first:
        orders = [False] if re.search("[AaPp][Mm]", text[0]) else [False, True]
    form = "mixed" if slashes or not year_first else "ISO8601"
    read = [pandas.to_datetime(plain, format=form, dayfirst=day, utc=True, errors="coerce") for day in orders]
    return min(read, key=lambda dates: (dates.isna().any(), dates.diff().abs().max()))


def instants(times: Any) -> tuple[FloatArray, float]:
    """Convert times of pandas or an array to s, and return what was taken off them.

    Dates count from the earliest one, whatever resolution and time zone; durations and numbers stay what they are.
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
        origin = given.min().timestamp()
        given = given - given.min()
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


def is_newest_first(time: FloatArray) -> bool:
    """Return whether times run backwards from row to row, but for a few rows: the newest row stands on top."""
    steps = np.diff(time)
    return bool(np.sum(steps < 0.0) > MOSTLY_BACK * np.sum(steps != 0.0))


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
