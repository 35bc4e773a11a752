"""Reading a recording from a file, and writing one."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aero_bayes.arguments import names_of, paths_of, require_type, shown
from aero_bayes.arrays import FloatArray
from aero_bayes.data.cells import is_newest_first, plain_seconds
from aero_bayes.data.checks import MIN_SAMPLES, check_recording
from aero_bayes.data.columns import ColumnMap, Layout, Rows, split_unit
from aero_bayes.data.logs import log_table
from aero_bayes.data.matlab import matlab_table
from aero_bayes.data.mend import from_first_message, hide, with_counters, with_steady_clock
from aero_bayes.data.recording import Recording, with_means
from aero_bayes.data.table import Signals, Table, column_called, joined, read_signals, without_repeats
from aero_bayes.data.tables import TextFile, frame_table
from aero_bayes.errors import InputError
from aero_bayes.files import whole_file
from aero_bayes.modelica.units import conversion, to_modelica_unit
from aero_bayes.unknown_names import known_names_hint, no_such_file

if TYPE_CHECKING:
    from aero_bayes.simulation.model import Model

#: Suffixes of the files of a folder that are looked at.
SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".mat", ".xlsx", ".parquet", ".feather", ".mf4", ".tdms", ".lvm")


def open_table(path: Path) -> Table:
    """Open a file of any form, which its content tells."""
    try:
        return matlab_table(path) or log_table(path) or frame_table(path) or TextFile(path).table
    except PermissionError:
        raise InputError(f"{path}: may not be read (permission denied)") from None


def data_files(folder: Path) -> list[Path]:
    """Return the files of a folder that may hold data, by their suffix."""
    return [p for p in sorted(folder.iterdir()) if p.is_file() and p.suffix.lower() in SUFFIXES]


def column_names(path: Path) -> list[str]:
    """Return names of the columns or signals of a file, or of all files of a folder."""
    if path.is_dir():
        return list(dict.fromkeys(name for file in data_files(path) for name in column_names(file)))
    table = open_table(path)
    if not table.names:
        raise InputError(f"{path}: holds no signal over time{table.hint}")
    return table.signal_names()


#: How late after the first one's start a run in a table may start, as a share of the length of the one above it.
MAX_LATE_START = 0.1


def read_recording(
    path: Path | str | Sequence[Path | str],
    columns: Mapping[str, ColumnMap | str] | None = None,
    *,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
    model: Model | None = None,
    layout: Layout | None = None,
) -> Recording:
    """Read and check a recording.

    Parameters
    ----------
    path : path, or sequence of path
        A table of text with a header, a ``.mat`` file of MATLAB, Simulink, Dymola or OpenModelica, a table in Excel or
        Parquet, a log in MDF 4, TDMS or ``.lvm``, or a table of Modelica, told apart by content. An empty cell (NaN in
        MATLAB) of an output is a gap. Several files of one run, or the folder that they are in, are joined on time:
        each signal is in one of them, and each file has times of its own.
    columns : mapping of str to ColumnMap or str, optional
        Where a signal is found if not under its own name and in SI: what the file calls it, or more by a ColumnMap.
    inputs, outputs : sequence of str, optional
        Signals to read; by default those that the model's package declares, else the model's own. Other columns of the
        file are not read.
    units : mapping of str to str, optional
        Units of the signals in the recording; by default the model's, to which a fit converts others.
    model : Model, optional
    layout : Layout, optional
        In place of these, with bounds of plausible values and inputs that are constant.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        One line that names file, row (the line of a text file, the first being 1; the sample of a MATLAB file), column
        and what was expected.

    Examples
    --------
    >>> aero_bayes.read_recording("train.csv", inputs=["F"], outputs=["position"])
    <Recording train: F -> position; 2001 rows, 40 s at 50 Hz>
    """
    if model is not None and not hasattr(model, "outputs"):
        raise InputError(f"model: expected a Model, as aero_bayes.load_model gives one; got {shown(model)}")
    if layout is None and model is None and outputs is None:
        raise InputError(f"{path}: name inputs and outputs, or give the model whose they are")
    inputs, outputs = (n if n is None else names_of(n, w) for n, w in ((inputs, "inputs"), (outputs, "outputs")))
    maps = {
        name: ColumnMap(found) if isinstance(found, str) else require_type(found, ColumnMap, f"columns: {name}")
        for name, found in (columns or {}).items()
    }
    layout = layout or Layout.of(inputs, outputs, units, model=model)
    layout = replace(layout, maps={**layout.maps, **maps})
    name, files = _run(paths_of(path, "path"), layout)
    return _recording(name, files, _read(files, layout), layout)


def read_recordings(
    paths: Sequence[Path | str],
    columns: Mapping[str, ColumnMap] | None = None,
    *,
    layout: Layout,
    batch: str | None = None,
) -> tuple[Recording, ...]:
    """Read several recordings as :func:`read_recording` does; one may stand in several files, and several in one.

    Each path is a file or a folder of a run; files that have all signals only together are one run. ``batch`` is the
    column of a table that names the run of each row; without it a table whose time runs back to its start holds several
    runs. They are called by the file and the batch, ``"runs 3"``."""
    layout = replace(layout, maps={**layout.maps, **(columns or {})})
    found: list[Recording] = []
    for given in _runs([Path(p) for p in paths], layout):
        name, files = _run(given, layout)
        signals = _read(files, layout, batch)
        batches = _batches(signals, batch if len(files) == 1 else None)
        short = [label for label, rows in batches.items() if label and rows.size < MIN_SAMPLES]
        if len(short) == len(batches):
            raise InputError(
                f"{files[0]}: each of its {len(short)} runs has fewer than {MIN_SAMPLES} rows, expected rows in the "
                "order of time, or the column that names their run in [data] batch"
            )
        told = []
        if len(batches) > 1 and batch is None:
            parted = f"the time runs back to its start {len(batches) - 1} times; each part is a recording"
            told.append(f"{name}: {parted}, {name} 1 and so on")
        if short:
            told.append(f"{name}: {', '.join(short)} with fewer than {MIN_SAMPLES} rows are left out")
        for label, rows in batches.items():
            if label not in short:
                part = replace(signals, frame=signals.frame.iloc[rows])
                found.append(_recording(f"{name} {label}" if label else name, files, part, layout))
        found[-1] = replace(found[-1], notes=(*found[-1].notes, *told))
    return tuple(found)


def _batches(signals: Signals, batch: str | None) -> dict[str, Rows]:
    """Return the rows of each run in a table, by its label; one without a label if there are not several."""
    if batch is not None:
        if signals.batch is None:
            raise InputError(f"[data] batch = {batch!r} needs a table with one time for all of its signals")
        labels = signals.batch[signals.frame.index].to_numpy()
        return {str(label): np.flatnonzero(labels == label) for label in dict.fromkeys(labels.tolist())}
    time = signals.frame["time"].to_numpy()
    starts = np.flatnonzero(np.diff(time) < 0.0) + 1
    edges = [0, *starts.tolist(), time.size]
    usual = float(np.median(np.diff(time))) if time.size > 1 else 0.0
    begins = all(time[b] - time[0] <= MAX_LATE_START * (time[b - 1] - time[a]) for a, b in pairwise(edges[:-1]))
    goes_on = any(0.0 < time[r + 1] - time[r - 1] < 3.0 * usual for r in starts if r + 1 < time.size)
    if not starts.size or not np.isfinite(time).all() or not begins or goes_on:  # it goes on after one wrong number
        return {"": np.arange(time.size)}
    return {str(k + 1): rows for k, rows in enumerate(np.split(np.arange(time.size), starts))}


def _signals_in(file: Path, layout: Layout) -> list[str]:
    """Return the signals that a file has a column of."""
    names, called = column_names(file), layout.called
    return [n for n in (*layout.held, *layout.measured) if column_called(called[n], names) is not None]


def _runs(paths: Sequence[Path], layout: Layout) -> list[list[Path]]:
    """Return the files of each run: one each, unless only all of them together have every signal."""
    files = [p for p in paths if not p.is_dir()]
    if len(files) < 2 or not all(p.is_file() for p in files):
        return [[p] for p in paths]
    held, measured = set(layout.held), set(layout.measured)
    there = {p: _signals_in(p, layout) for p in files}
    partial = [p for p, own in there.items() if own and not (held <= set(own) and set(own) & measured)]
    if not partial:
        return [[p] for p in paths]
    owners = [n for own in there.values() for n in own]
    once = len(set(owners)) == len(owners) and held <= set(owners)
    if once and len(partial) == len(files) == len(paths):
        return [files]
    lacking = [n for n in layout.held if n not in there[partial[0]]] or layout.measured
    raise InputError(
        f"{partial[0]}: has {', '.join(there[partial[0]])} but not {lacking[0]}; if it is a part of a run, put the "
        "files of each run in a folder of its own and give the folder"
    )


def _run(files: Sequence[Path], layout: Layout) -> tuple[str, list[Path]]:
    """Return the name of a run and its files that hold a signal; those of a folder for the folder."""
    for file in files:
        if not file.exists():
            raise InputError(no_such_file(file))
    if len(files) > 1 or not files[0].is_dir():
        return "+".join(file.stem for file in files), list(files)
    parts = [p for p in data_files(files[0]) if _signals_in(p, layout)]
    if not parts:
        wanted = ", ".join([*layout.held, *layout.measured])
        raise InputError(f"{files[0]}: is a folder in which no file has a column of {wanted}")
    return files[0].name, parts


def _read(files: Sequence[Path], layout: Layout, batch: str | None = None) -> Signals:
    """Read all columns of a run, in their own units; the time in seconds where no unit is given."""
    if len(files) > 1:
        return _joined(files, layout)
    held, measured = layout.held, layout.measured
    wanted = [*held, *(name for name in layout.maps if name != "time")]
    found = _columns(files[0], [*held, *measured], wanted, layout, batch)
    if not any(name in found.frame for name in measured):
        missing = ", ".join(layout.called[name] for name in measured)
        there = known_names_hint(layout.called[measured[0]] if measured else "", column_names(files[0]))
        raise InputError(f"{files[0]}: no output column, expected at least one of {missing}{there}")
    return found


def _joined(files: Sequence[Path], layout: Layout) -> Signals:
    """Read each signal from the file that has it, at the times of all."""
    pairs: dict[str, tuple[FloatArray, FloatArray]] = {}
    named: dict[str, str] = {}
    told, sums, begin = [], [], None
    for file in files:
        own = _signals_in(file, layout)
        found = _columns(file, own, own, layout)
        begin = found.origin if begin is None else begin
        time = found.frame["time"].to_numpy() + (found.origin - begin)
        for name in own:
            if name in pairs:
                raise InputError(f"{file}: has {name}, as another file of its run has; expected one only")
            marked = found.frame.index.isin(found.bad.get(name, []))
            pairs[name] = time, np.where(marked, np.nan, found.frame[name])
        named |= dict(found.called)
        told += [f"{', '.join(own)} from {file.name}", *found.told]
        sums.append(found.sha256)
    lacking = [name for name in layout.held if name not in pairs]
    lacking += [] if set(pairs) & set(layout.measured) else layout.measured
    if lacking:
        raise InputError(f"{files[0].parent}: no file of the run has a column of {layout.called[lacking[0]]}")
    begins, ends = zip(*((times[0], times[-1]) for times, _ in pairs.values() if times.size), strict=True)
    if max(begins) > min(ends):
        raise InputError(
            f"{files[0]}: its times and those of {files[-1].name} do not overlap, expected files of one run that "
            "count time from one instant"
        )
    sha256 = hashlib.sha256("".join(sums).encode()).hexdigest()
    return Signals(joined(pairs, layout.held), named, (f"joined on time: {'; '.join(told)}",), sha256=sha256)


def _columns(
    file: Path, names: Sequence[str], wanted: Sequence[str], layout: Layout, batch: str | None = None
) -> Signals:
    """Read the time and some columns, of which the file must have those that are ``wanted``."""
    if not file.is_file():
        raise InputError(f"{file}: is not a file")
    found = read_signals(open_table(file), layout, names, wanted, batch)
    frame, told, origin = found.frame, found.told, found.origin
    if is_newest_first(frame["time"].to_numpy()):
        frame = frame.iloc[::-1]
        told = (*told, f"{file.name}: the newest row stands first; read in the order of time")
    frame = without_repeats(frame, layout.held)
    if layout.maps.get("time", ColumnMap("time")).unit is None:
        time, begin = plain_seconds(frame["time"].to_numpy())
        frame, origin = frame.assign(time=time), origin + begin
    with file.open("rb") as content:
        sha256 = hashlib.file_digest(content, "sha256").hexdigest()
    return replace(found, frame=frame, told=told, origin=origin, sha256=sha256)


def _recording(name: str, files: Sequence[Path], found: Signals, layout: Layout) -> Recording:
    """Return the checked recording of what a file gave, in the units of the layout."""
    frame, maps, rows = found.frame, layout.maps, found.frame.index.to_numpy()
    missing = {n: column.missing for n, column in maps.items()}
    raw = {n: np.where(np.isin(frame[n], missing.get(n) or ()), np.nan, frame[n]) for n in frame}
    values = {n: _map_of(n, layout, found).convert(column, n, layout.units[n]) for n, column in raw.items()}
    first = 1 if not rows.size else -int(rows[0]) if rows[0] > rows[-1] else int(rows[0])
    recording = Recording(
        name=name,
        time=values["time"],
        inputs={n: np.full(values["time"].size, value) for n, value in layout.constants.items()}
        | {n: values[n] for n in layout.held},
        outputs={n: values[n] for n in layout.measured if n in values},
        units={n: unit for n, unit in layout.units.items() if n in values},
        sha256=found.sha256,
        path=files[0] if len(files) == 1 and files[0].is_file() else None,
        first_row=first,
        notes=(*found.told, *_doubts(layout, found)),
    )
    recording = with_steady_clock(recording)
    for n, marked in found.bad.items():
        if (bad := frame.index.isin(marked)).any():
            what = f"{int(bad.sum())} readings of {n} are marked as bad in its quality column."
            recording = hide(recording, n, bad, "quality", what)
    mended = {"time", *(n for n, column in maps.items() if column.unwrap or column.reset)}
    recording = with_counters(recording, {n: v for n, v in raw.items() if n not in mended})
    own = {n: v for n, v in raw.items() if n != "time" and missing.get(n) is None}
    recording = from_first_message(recording, own, [n for n in layout.held if missing.get(n)])
    begin = abs(recording.first_row - first)
    check_recording(recording, layout, lambda row: f"{found.row} {rows[row + begin]}")
    return with_means(recording, {n: maps[n].stamp for n in values if n in maps and maps[n].kind == "mean"})


def _doubts(layout: Layout, found: Signals) -> list[str]:
    """Ask about columns whose header has another unit than they are read in: that is given, or the model's."""
    doubts = []
    for name, header in found.called.items():
        column = _map_of(name, layout, found)
        told, given = split_unit(header)[1], to_modelica_unit(column.unit or layout.units.get(name, ""))
        known = conversion(told, given) if told and given and told != given else None
        plain = (column.scale, column.offset) == (1.0, 0.0) and not (name == "time" and found.origin)
        if plain and known not in (None, (1.0, 0.0)):
            doubts.append(f"{name} is read in {given}, but its header says {told}: which of them is right?")
    return doubts


def _map_of(name: str, layout: Layout, found: Signals) -> ColumnMap:
    """Return how a column is read: in the unit in its name where it is asked for without that."""
    column = layout.maps.get(name, ColumnMap(name))
    called = re.fullmatch(r".*? \[(.*)\]", found.called.get(name, ""))
    asked = column.unit is None and called and found.called[name] != column.source
    return replace(column, unit=called[1]) if asked and called else column


def write_csv(recording: Recording, path: Path | str) -> Path:
    """Write a recording so that :func:`read_recording` returns the same numbers; gaps become empty cells.

    Parameters
    ----------
    recording : Recording
    path : path
        The file; it appears whole or not at all.

    Examples
    --------
    >>> from aero_bayes.data import write_csv
    >>> write_csv(recording.slice(0.0, 10.0), "part.csv").name
    'part.csv'
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(target) as temporary:
        recording.to_frame().to_csv(temporary, lineterminator="\n", encoding="utf-8")
    return target
