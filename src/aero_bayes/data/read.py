"""Reading a recording from a file, and writing one."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arguments import names_of, paths_of, require_type, shown
from aero_bayes.arrays import FloatArray
from aero_bayes.data.cells import is_newest_first, plain_seconds
from aero_bayes.data.checks import MIN_SAMPLES, check_recording
from aero_bayes.data.columns import ColumnMap, Layout, split_unit
from aero_bayes.data.logs import log_source
from aero_bayes.data.matlab import matlab_source
from aero_bayes.data.means import with_means
from aero_bayes.data.recording import Recording
from aero_bayes.data.screen import from_first_message, hide, with_counters, with_steady_clock
from aero_bayes.data.source import Columns, Source, column_called, joined, read_columns, without_repeats
from aero_bayes.data.tables import frame_source, text_source
from aero_bayes.errors import InputError
from aero_bayes.files import whole_file
from aero_bayes.modelica.units import conversion, to_modelica_unit
from aero_bayes.unknown_names import known_names_hint, no_such_file

if TYPE_CHECKING:
    from aero_bayes.simulation.model import Model

#: Suffixes of the files of a folder that are looked at.
SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".mat", ".xlsx", ".parquet", ".feather", ".mf4", ".tdms", ".lvm")


def open_source(path: Path) -> Source:
    """Open a file of any form, which its content tells."""
    try:
        return matlab_source(path) or log_source(path) or frame_source(path) or text_source(path)
    except PermissionError:
        raise InputError(f"{path}: may not be read (permission denied)") from None


def data_files(folder: Path) -> list[Path]:
    """Return the files of a folder that may hold data, by their suffix."""
    return [p for p in sorted(folder.iterdir()) if p.is_file() and p.suffix.lower() in SUFFIXES]


def column_names(path: Path) -> list[str]:
    """Return names of the columns or signals of a file, or of all files of a folder."""
    if path.is_dir():
        return list(dict.fromkeys(name for file in data_files(path) for name in column_names(file)))
    source = open_source(path)
    if not source.names:
        raise InputError(f"{path}: holds no signal over time{source.hint}")
    return source.signal_names()


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
    asked = _Asked(layout or Layout.of(inputs, outputs, units, model=model), maps)
    name, parts = asked.run(paths_of(path, "path"))
    return asked.recording(name, parts, asked.read(parts))


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
    asked = _Asked(layout, dict(columns or {}), batch)
    found: list[Recording] = []
    for files in asked.runs([Path(p) for p in paths]):
        name, parts = asked.run(files)
        given = asked.read(parts)
        batches = _batches(given, batch if len(parts) == 1 else None)
        short = [label for label, rows in batches.items() if label and rows.size < MIN_SAMPLES]
        for label, rows in batches.items():
            if label in short:
                continue
            own = _at_rows(given, rows) if label else given
            found.append(asked.recording(f"{name} {label}" if label else name, parts, own))
        told = []
        if len(short) == len(batches):
            raise InputError(
                f"{parts[0]}: each of its {len(short)} runs has fewer than {MIN_SAMPLES} rows, expected rows in the "
                "order of time, or the column that names their run in [data] batch"
            )
        if len(batches) > 1 and batch is None:
            parted = f"the time runs back to its start {len(batches) - 1} times; each part is a recording"
            told.append(f"{name}: {parted}, {name} 1 and so on")
        if short:
            told.append(f"{name}: {', '.join(short)} with fewer than {MIN_SAMPLES} rows are left out")
        if told and found:
            found[-1] = replace(found[-1], notes=(*found[-1].notes, *told))
    return tuple(found)


def _batches(given: Columns, batch: str | None) -> dict[str, NDArray[np.intp]]:
    """Return the rows of each run in a table, by its label; one without a label if there are not several."""
    if batch is not None:
        if given.batch is None:
            raise InputError(f"[data] batch = {batch!r} needs a table with one time for all of its signals")
        labels = np.asarray(given.batch)
        return {str(label): np.flatnonzero(labels == label) for label in dict.fromkeys(labels.tolist())}
    time = given.columns["time"]
    starts = np.flatnonzero(np.diff(time) < 0.0) + 1
    edges = [0, *starts.tolist(), time.size]
    usual = float(np.median(np.diff(time))) if time.size > 1 else 0.0
    begins = all(time[b] - time[0] <= MAX_LATE_START * (time[b - 1] - time[a]) for a, b in pairwise(edges[:-1]))
    goes_on = any(0.0 < time[r + 1] - time[r - 1] < 3.0 * usual for r in starts if r + 1 < time.size)
    if not starts.size or not np.isfinite(time).all() or not begins or goes_on:  # it goes on after one wrong number
        return {"": np.arange(time.size)}
    return {str(k + 1): rows for k, rows in enumerate(np.split(np.arange(time.size), starts))}


@dataclass(frozen=True)
class _Asked:
    """What is asked of files: the columns of a layout, where they stand, and the column that names batches."""

    layout: Layout
    maps: dict[str, ColumnMap]
    batch: str | None = None

    def __post_init__(self) -> None:
        for column in self.maps:
            if column not in self.layout.units:
                known = ", ".join(self.layout.units)
                raise InputError(f"columns: {column} is not a column of the model, expected one of {known}")

    @property
    def held(self) -> list[str]:
        """Names of inputs."""
        return [quantity.name for quantity in self.layout.inputs]

    @property
    def outputs(self) -> list[str]:
        """Names of outputs."""
        return [quantity.name for quantity in self.layout.outputs]

    @property
    def sources(self) -> dict[str, str]:
        """What a file calls each column."""
        return {name: self.maps[name].source if name in self.maps else name for name in self.layout.units}

    def signals_in(self, file: Path) -> list[str]:
        """Return the signals that a file has a column of."""
        names = column_names(file)
        return [n for n in (*self.held, *self.outputs) if column_called(self.sources[n], names) is not None]

    def runs(self, paths: Sequence[Path]) -> list[list[Path]]:
        """Return the files of each run: one each, unless only all of them together have every signal."""
        files = [p for p in paths if not p.is_dir()]
        if len(files) < 2 or not all(p.is_file() for p in files):
            return [[p] for p in paths]
        there = {p: self.signals_in(p) for p in files}
        partial = [p for p, own in there.items()
                   if own and not (set(self.held) <= set(own) and set(own) & set(self.outputs))]  # fmt: skip
        if not partial:
            return [[p] for p in paths]
        owners = [n for own in there.values() for n in own]
        once = len(set(owners)) == len(owners) and set(self.held) <= set(owners)
        if once and len(partial) == len(files) == len(paths):
            return [files]
        lacking = [n for n in self.held if n not in there[partial[0]]] or self.outputs
        raise InputError(
            f"{partial[0]}: has {', '.join(there[partial[0]])} but not {lacking[0]}; if it is a part of a run, put the "
            "files of each run in a folder of its own and give the folder"
        )

    def run(self, files: Sequence[Path]) -> tuple[str, list[Path]]:
        """Return the name of a run and its files that hold a signal; those of a folder for the folder."""
        for file in files:
            if not file.exists():
                raise InputError(no_such_file(file))
        if len(files) > 1 or not files[0].is_dir():
            return "+".join(file.stem for file in files), list(files)
        parts = [p for p in data_files(files[0]) if self.signals_in(p)]
        if not parts:
            wanted = ", ".join([*self.held, *self.outputs])
            raise InputError(f"{files[0]}: is a folder in which no file has a column of {wanted}")
        return files[0].name, parts

    def read(self, files: Sequence[Path]) -> Columns:
        """Read all columns of a run, in their own units; the time in seconds where no unit is given."""
        if len(files) > 1:
            return self._joined(files)
        given = self._columns(files[0], [*self.held, *self.outputs], [*self.held, *self.maps], self.batch)
        if not any(name in given.columns for name in self.outputs):
            missing = ", ".join(self.sources[name] for name in self.outputs)
            there = known_names_hint(self.sources[self.outputs[0]] if self.outputs else "", column_names(files[0]))
            raise InputError(f"{files[0]}: no output column, expected at least one of {missing}{there}")
        return given

    def _joined(self, files: Sequence[Path]) -> Columns:
        """Read each signal from the file that has it, at the times of all."""
        pairs: dict[str, tuple[FloatArray, FloatArray]] = {}
        named: dict[str, str] = {}
        notes, sums, begin = [], [], None
        for file in files:
            own = self.signals_in(file)
            given = self._columns(file, own, own)
            begin = given.origin if begin is None else begin
            time = given.columns["time"] + (given.origin - begin)
            for name in own:
                if name in pairs:
                    raise InputError(f"{file}: has {name}, as another file of its run has; expected one only")
                pairs[name] = time, np.where(given.bad.get(name, False), np.nan, given.columns[name])
            named |= dict(given.named)
            notes += [f"{', '.join(own)} from {file.name}", *([given.note] if given.note else [])]
            sums.append(given.sha256)
        lacking = [name for name in self.held if name not in pairs]
        lacking += [] if set(pairs) & set(self.outputs) else self.outputs
        if lacking:
            raise InputError(f"{files[0].parent}: no file of the run has a column of {self.sources[lacking[0]]}")
        begins, ends = zip(*((times[0], times[-1]) for times, _ in pairs.values() if times.size), strict=True)
        if max(begins) > min(ends):
            raise InputError(
                f"{files[0]}: its times and those of {files[-1].name} do not overlap, expected files of one run that "
                "count time from one instant"
            )
        sha256 = hashlib.sha256("".join(sums).encode()).hexdigest()
        return Columns(joined(pairs, self.held), sha256, named, note="joined on time: " + "; ".join(notes))

    def _columns(self, file: Path, names: Sequence[str], wanted: Sequence[str], batch: str | None = None) -> Columns:
        """Read the time and some columns, of which the file must have those that are ``wanted``."""
        if not file.is_file():
            raise InputError(f"{file}: is not a file")
        asked = {name: self.sources[name] for name in ("time", *names)}
        words = {quantity.name: quantity.words for quantity in (*self.layout.inputs, *self.layout.outputs)}
        given = read_columns(open_source(file), asked, ["time", *wanted], self.held, batch, words)
        if is_newest_first(given.columns["time"]):
            told = f"{file.name}: the newest row stands first; read in the order of time"
            last = given.first_row + given.columns["time"].size - 1
            given = replace(_at_rows(given, np.arange(last - given.first_row, -1, -1)), first_row=-last)
            given = replace(given, note="; ".join(filter(None, (given.note, told))))
        # without the rows that a simulator writes a second time at an event
        keep = without_repeats(given.columns, [name for name in self.held if name in given.columns])
        given = given if keep.all() else replace(_at_rows(given, np.flatnonzero(keep)), first_row=given.first_row)
        if self.maps.get("time", ColumnMap("time")).unit is None:
            given.columns["time"], origin = plain_seconds(given.columns["time"])
            given = replace(given, origin=given.origin + origin)
        return given

    def recording(self, name: str, files: Sequence[Path], given: Columns) -> Recording:
        """Return the checked recording of what a file gave, in the units of the layout."""
        missing = {n: column.missing for n, column in self.maps.items()}
        raw = {n: np.where(np.isin(v, missing.get(n) or ()), np.nan, v) for n, v in given.columns.items()}
        values = {n: self._in_unit(column, n, given.named) for n, column in raw.items()}
        recording = Recording(
            name=name,
            time=values["time"],
            inputs={n: np.full(values["time"].size, value) for n, value in self.layout.constants.items()}
            | {n: values[n] for n in self.held},
            outputs={n: values[n] for n in self.outputs if n in values},
            units={n: unit for n, unit in self.layout.units.items() if n in values},
            sha256=given.sha256,
            path=files[0] if len(files) == 1 and files[0].is_file() else None,
            first_row=given.first_row,
            notes=(*([given.note] if given.note else []), *self._doubts(given)),
        )
        recording = with_steady_clock(recording)
        for n, rows in given.bad.items():
            what = f"{int(rows.sum())} readings of {n} are marked as bad in its quality column."
            recording = hide(recording, n, rows, "quality", what)
        first = recording.first_row
        mended = {"time", *(n for n, column in self.maps.items() if column.unwrap or column.reset)}
        recording = with_counters(recording, {n: v for n, v in raw.items() if n not in mended})
        own = {n: v for n, v in raw.items() if n != "time" and missing.get(n) is None}
        recording = from_first_message(recording, own, [n for n in self.held if missing.get(n)])
        begin = abs(recording.first_row - first)
        check_recording(recording, self.layout, lambda row: given.line(row + begin))
        return with_means(recording, {n: self.maps[n].stamp for n in values if self._is_mean(n)})

    def _is_mean(self, name: str) -> bool:
        return name in self.maps and self.maps[name].kind == "mean"

    def _doubts(self, columns: Columns) -> list[str]:
        """Ask about columns whose header has another unit than they are read in: that is given, or the model's."""
        found = []
        for name, header in columns.named.items():
            column = self._map_of(name, columns.named)
            told, given = split_unit(header)[1], to_modelica_unit(column.unit or self.layout.units.get(name, ""))
            known = conversion(told, given) if told and given and told != given else None
            plain = (column.scale, column.offset) == (1.0, 0.0) and not (name == "time" and columns.origin)
            if plain and known not in (None, (1.0, 0.0)):
                found.append(f"{name} is read in {given}, but its header says {told}: which of them is right?")
        return found

    def _in_unit(self, values: FloatArray, name: str, named: Mapping[str, str]) -> FloatArray:
        """Convert values to the unit of the layout, from the unit that was given or the one in the column's name."""
        return self._map_of(name, named).convert(values, name, self.layout.units[name])

    def _map_of(self, name: str, named: Mapping[str, str]) -> ColumnMap:
        """Return how a column is read: in the unit in its name where it is asked for without that."""
        column = self.maps.get(name, ColumnMap(name))
        called = re.fullmatch(r".*? \[(.*)\]", named.get(name, ""))
        asked = column.unit is None and called and named[name] != column.source
        return replace(column, unit=called[1]) if asked and called else column


def _at_rows(given: Columns, rows: NDArray[np.intp]) -> Columns:
    """Return some rows."""
    return replace(
        given,
        columns={name: values[rows] for name, values in given.columns.items()},
        bad={name: marked[rows] for name, marked in given.bad.items() if marked[rows].any()},
        batch=None if given.batch is None else [given.batch[row] for row in rows],
        line=lambda row: given.line(int(rows[row])),
        first_row=given.first_row + int(rows[0]),
    )


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
