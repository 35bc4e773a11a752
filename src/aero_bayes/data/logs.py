"""Logs: MDF 4 (``.mf4``, of dSPACE, Vector, ETAS), TDMS and ``.lvm`` of LabVIEW; and tables of Modelica.

A signal with a unit is called ``v [km/h]``, in TDMS behind its group where two groups have one of its name. Each signal
has its own times; those of one recording are brought to common ones. A table of Modelica, as ``CombiTimeTable`` reads
it, begins with ``#1``; its matrix ``tab`` of m columns becomes ``tab(1)`` ... ``tab(m)``, the first being the time.
Where a time is there twice, the table jumps, and the later row holds.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from pathlib import Path

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.cells import instants
from aero_bayes.data.table import Table, is_time_name
from aero_bayes.data.tables import read_by
from aero_bayes.errors import InputError

#: Group, name, unit, times and values.
Signal = tuple[str, str, str, FloatArray, FloatArray]
#: Units that say nothing.
NO_UNITS = ("", "-", "1", "none")
MATRIX = re.compile(r"\s*(?:double|float)\s+(\w+)\s*\(\s*(\d+)\s*,\s*(\d+)\s*\)\s*(?:#.*)?")
#: What ends a comment in a line of Modelica's tables, and what separates numbers.
COMMENT, SEPARATORS = re.compile(r"(#|//|/\*).*"), re.compile(r"[\s,;]+")


def log_table(path: Path) -> Table | None:
    """Return all signals with their times; None for a file that is no log, by its first bytes.

    InputError for a log that cannot be read, or whose reader is not installed."""
    with path.open("rb") as file:
        head = file.read(64).removeprefix(b"\xef\xbb\xbf")
    forms = ((rb"MDF     |UnFinMF ", _mdf, "mdf"), (rb"TDSm", _tdms, "tdms"),
             (rb"LabVIEW Measurement", _lvm, ""), (rb"#1\s*\n", _modelica_table, ""))  # fmt: skip
    return next((read_by(read, path, extra) for begin, read, extra in forms if re.match(begin, head)), None)


def _named(path: Path, found: list[Signal]) -> Table:
    """Make signals of (group, name, unit, times, values); times are called ``time``, or by their group."""
    if not found:
        raise InputError(f"{path}: holds no signal over time")
    count = Counter(name for _, name, *_ in found)
    vectors: dict[str, FloatArray] = {}
    clocks: dict[str, str] = {}
    several = any(not np.array_equal(times, found[0][3]) for *_, times, _ in found)
    for group, name, unit, times, values in found:
        mark = f" [{unit}]" if unit.casefold() not in NO_UNITS else ""
        called = (name if count[name] == 1 else f"{group}/{name}") + mark
        clock = f"time of {group}" if several else "time"
        if clock in vectors and not np.array_equal(vectors[clock], times):
            clock = f"time of {called}"
        vectors |= {clock: times, called: values}
        clocks[called] = clock
    return Table.of_vectors(path, vectors, clocks)


def _mdf(path: Path) -> Table:
    from asammdf import MDF as File

    found = []
    with File(path) as file:
        times_of = set(file.masters_db.items())
        for index, group in enumerate(file.virtual_groups.values()):
            channels = [(g, c) for g in group.groups for c in range(len(file.groups[g].channels))]
            for signal in file.select([(None, g, c) for g, c in channels if (g, c) not in times_of]):
                values = np.asarray(signal.samples)
                if values.dtype.kind in "biuf" and values.ndim == 1 and values.size > 1:
                    times = np.asarray(signal.timestamps, dtype=float)
                    found.append((f"group {index + 1}", signal.name, signal.unit or "", times, values.astype(float)))
    return _named(path, found)


def _tdms(path: Path) -> Table:
    from nptdms import TdmsFile

    found = []
    for group in TdmsFile.read(path).groups():
        channels = [channel for channel in group.channels() if len(channel) > 1]
        timed = [c for c in channels if is_time_name(c.name) and "wf_increment" not in c.properties]
        for channel in channels:
            values = np.asarray(channel[:])
            if channel in timed or values.dtype.kind not in "biuf":
                continue
            if "wf_increment" in channel.properties:
                times = np.asarray(channel.time_track(), dtype=float)
            elif len(timed) == 1 and len(timed[0]) == values.size:
                times = instants(np.asarray(timed[0][:]))[0]
            else:
                raise InputError(
                    f"{path}: signal {channel.name} has no times: neither wf_increment nor one channel of its group "
                    "called time"
                )
            unit = str(channel.properties.get("unit_string", ""))
            found.append((group.name, channel.name, unit, times, values.astype(float)))
    return _named(path, found)


def _lvm(path: Path) -> Table:
    """Return one segment of a ``.lvm``; times are a column for all signals, one for each, or steps from ``X0``."""
    import pandas

    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    ends = [k for k, line in enumerate(lines) if line.strip().startswith("***End_of_Header***")]
    if len(ends) > 2:
        raise InputError(f"{path}: has {len(ends) - 1} segments, expected one: write one header only, or cut the file")
    if not ends:
        raise InputError(f"{path}: has no ***End_of_Header***, expected a LabVIEW measurement")
    separator = "," if any(line.startswith("Separator,") for line in lines[: ends[0]]) else "\t"
    about = {cells[0]: cells[1:] for line in lines[: ends[-1]] if (cells := line.split(separator))[0]}
    header = next(k for k in range(ends[-1] + 1, len(lines)) if lines[k].strip())
    decimal = (about.get("Decimal_Separator") or ["."])[0] or "."
    names = [cell.strip() for cell in lines[header].split(separator)]
    text = io.StringIO("\n".join(lines[header + 1 :]))
    frame = pandas.read_csv(text, sep=separator, decimal=decimal, header=None, names=range(len(names)), index_col=False)
    units = [u.strip() for u in about.get("Y_Unit_Label", [])]
    found, time, number = [], None, 0
    for column, name in enumerate(names):
        if name.casefold() in ("x_value", "time"):
            time = frame[column].to_numpy(dtype=float) if frame[column].notna().any() else None
        elif name.casefold() != "comment" and frame[column].notna().sum() > 1:
            values = frame[column].to_numpy(dtype=float)
            if time is not None:
                own = time
            else:
                first, step = (float(about[key][number].replace(decimal, ".")) for key in ("X0", "Delta_X"))
                own = first + step * np.arange(values.size)
            known = np.isfinite(own)
            unit = units[number] if number < len(units) else ""
            found.append((f"channel {number + 1}", name, unit, own[known], values[known]))
            number += 1
    return _named(path, found)


def _modelica_table(path: Path) -> Table:
    """Return the columns of all matrices; InputError for one that has not the size that it states."""
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    vectors: dict[str, FloatArray] = {}
    clocks: dict[str, str] = {}
    starts = [(k, found) for k, line in enumerate(lines) if (found := MATRIX.fullmatch(line))]
    for (start, found), end in zip(starts, [*(k for k, _ in starts[1:]), len(lines)], strict=True):
        name, rows, columns = found[1], int(found[2]), int(found[3])
        words = SEPARATORS.split(" ".join(COMMENT.sub("", line) for line in lines[start + 1 : end]).strip())
        try:
            numbers = np.array([float(word) for word in words[: rows * columns]]).reshape(rows, columns)
        except ValueError:
            raise InputError(
                f"{path}, row {start + 1}: matrix {name} of {rows} rows and {columns} columns: found {len(words)} "
                f"numbers and words, expected {rows * columns} numbers"
            ) from None
        called = [f"{name}({k + 1})" for k in range(columns)]
        last = np.append(np.diff(numbers[:, 0]) != 0.0, True)
        vectors |= dict(zip(called, np.ascontiguousarray(numbers[last].T), strict=True))
        clocks |= dict.fromkeys(called[1:], called[0])
    if not vectors:
        raise InputError(f"{path}: begins as a table of Modelica (#1) but has no matrix such as double tab(10,3)")
    return Table.of_vectors(path, vectors, clocks)
