"""Tables of pandas: data frames, and files that pandas reads; times of any type and resolution become seconds."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import InputError
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas

FloatArray = NDArray[np.float64]
#: Function of pandas that reads a file by its suffix, and the part of an installation that it needs.
READERS = {
    ".xlsx": ("read_excel", "excel"),
    ".xlsm": ("read_excel", "excel"),
    ".parquet": ("read_parquet", "parquet"),
    ".feather": ("read_feather", "parquet"),
}
#: Suffixes of tables that are not read, and what to do instead.
REFUSED = {
    ".xls": "save it as .xlsx or CSV",
    ".h5": "write it as CSV or Parquet",
    ".hdf5": "write it as CSV or Parquet",
}


def is_table(path: Path) -> bool:
    """Whether a file is a table that pandas reads, by its suffix.

    Raises
    ------
    InputError
        For one that is known and not read.
    """
    suffix = path.suffix.lower()
    if suffix in REFUSED:
        raise InputError(f"{path}: {suffix} is not read: {REFUSED[suffix]}")
    return suffix in READERS


def read_frame(path: Path) -> pandas.DataFrame:
    """Read a table.

    Raises
    ------
    InputError
        If the reader is not installed, or cannot read the file.
    """
    import pandas

    name, extra = READERS[path.suffix.lower()]
    try:
        # Without its name pandas would ask the file for its engine first.
        options = {"engine": "openpyxl"} if extra == "excel" else {}
        frame: pandas.DataFrame = getattr(pandas, name)(path, **options)
    except ImportError:
        raise InputError(
            f"{path}: reading {path.suffix} files needs a further package: pip install 'aero-bayes[{extra}]', or write "
            "the table as CSV"
        ) from None
    except Exception as error:
        reason = f"{error}".partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: cannot be read as a table: {reason}") from None
    if frame.index.name is not None and frame.index.name not in frame.columns:
        frame = frame.reset_index()
    frame.columns = [str(column).strip() for column in frame.columns]
    return frame


def frame_columns(
    path: Path, time: str, wanted: Sequence[str], optional: Sequence[str]
) -> tuple[dict[str, FloatArray], str]:
    """Columns of a table by name, and the hash of its file.

    Parameters
    ----------
    path : Path
    time : str
        Column of the times.
    wanted, optional : sequence of str
        Columns that must be there, and that are read where they are.

    Raises
    ------
    InputError
        For a column that is missing, there twice, or holds something else than numbers.
    """
    frame = read_frame(path)
    names = list(frame.columns)
    found: dict[str, FloatArray] = {}
    for name in (*wanted, *optional):
        if names.count(name) > 1:
            raise InputError(f"{path}: column {name} appears {names.count(name)} times, expected once")
        if name in names:
            found[name] = seconds(frame[name]) if name == time else numbers(frame[name], str(path))
        elif name in wanted:
            raise InputError(f"{path}: no column {name}{known_names_hint(name, names)}")
    return found, hashlib.sha256(path.read_bytes()).hexdigest()


def seconds(times: Any) -> FloatArray:
    """Times in s of a series or an index of pandas, or an array.

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
    """A column as numbers, NaN where there is none; InputError for dates, durations and text."""
    name = getattr(column, "name", None) or "time"
    kind = getattr(getattr(column, "dtype", None), "kind", "f")
    try:
        if kind in "mM":
            raise TypeError
        return np.asarray(column, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: column {name} holds something else than numbers") from None


def _dates(values: Any) -> Any:
    """Dates in universal time; text with several offsets is compared by the instants that it names."""
    import pandas

    text = isinstance(values.iloc[0], str)
    return pandas.to_datetime(values, utc=True, **({"format": "ISO8601"} if text else {}))
