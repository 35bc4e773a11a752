"""From a recording to an experiment that a simulator can run."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arguments import names_of
from aero_bayes.arrays import FloatArray
from aero_bayes.data.cells import instants, is_newest_first, numbers
from aero_bayes.data.checks import check_recording
from aero_bayes.data.columns import ColumnMap, Stamp
from aero_bayes.data.find_table import DataFinding
from aero_bayes.data.table import is_time_name
from aero_bayes.display import table_html
from aero_bayes.errors import InputError
from aero_bayes.figures import Picture, drawn
from aero_bayes.simulation.interface import Experiment, InputSignal, Interpolation
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas

    from aero_bayes.data.summary import RecordingSummary


@dataclass(frozen=True, eq=False)
class Recording:
    """Inputs and outputs of one run over time.

    Parameters
    ----------
    name : str
        What reports call it.
    time : ndarray, shape (n,)
        Strictly increasing sample times in s, not necessarily even.
    inputs : mapping of str to ndarray, shape (n,)
        What was applied; a value holds from its sample to the next. Always finite.
    outputs : mapping of str to ndarray, shape (n,)
        What was measured; NaN where a reading is missing.
    units : mapping of str to str
        Unit of every column, ``time`` included (s); a fit converts columns to the units of its model.
    sha256 : str
        Hash of the file's bytes, or of the arrays where there is no file.
    path : Path, optional
        Where it was read from.
    findings : tuple of DataFinding
        Faults of the readings that were found, see :func:`aero_bayes.data.mend`.
    resumes : bool
        Whether it begins in mid-motion after a gap, so that the initial value of every state is estimated.
    part_of : str
        Name of the recording that it is a part of, where one was cut at a gap.
    first_row : int
        Row of the file with the first sample, the first line being 1; 1 for arrays; negative in a file with the newest
        row first.
    cuts : tuple of int
        Samples at which a part begins anew, since the clock was set back before them.
    notes : tuple of str
        What of its files was not read, and how several of them were joined.
    known : mapping of str to float
        Parameters of the model whose values are known in this run and may differ in others, in SI units.
    means : mapping of str to {"beginning", "end"}
        Outputs that are means over the interval that begins, or ends, at their time.
    mended : bool
        Whether its faults were mended already, which is done once.

    Examples
    --------
    >>> recording
    <Recording train: F -> position; 2001 rows, 40 s at 50 Hz>
    >>> recording.rows, recording.duration, round(recording.rate_hz), round(recording.interval, 6)
    (2001, 40.0, 50, 0.02)
    >>> recording.measured(("position",)).shape
    (2001, 1)
    >>> recording.slice(10.0, 20.0).rows
    500
    >>> int(np.isfinite(recording.without(after=30.0).outputs["position"]).sum())
    1500
    >>> recording.rows_where(recording.time >= 20.0, "late").rows
    1001
    >>> sorted(recording.to_dict())
    ['file', 'rate_hz', 'rows', 'sha256']
    """

    name: str
    time: FloatArray
    inputs: Mapping[str, FloatArray]
    outputs: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    sha256: str = ""
    path: Path | None = None
    findings: tuple[DataFinding, ...] = ()
    resumes: bool = False
    part_of: str = ""
    first_row: int = 1
    cuts: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    known: Mapping[str, float] = field(default_factory=dict)
    means: Mapping[str, Stamp] = field(default_factory=dict)
    mended: bool = False

    def __post_init__(self) -> None:
        dates = np.asarray(self.time).dtype.kind in "mM"
        object.__setattr__(self, "time", instants(self.time)[0] if dates else numbers(self.time, self.name))
        for role in ("inputs", "outputs"):
            columns = {c: numbers(values, self.name, c) for c, values in getattr(self, role).items()}
            object.__setattr__(self, role, columns)
        for column, values in {"time": self.time, **self.inputs, **self.outputs}.items():
            if values.shape != self.time.shape or values.ndim != 1:
                raise InputError(f"{self.name}: column {column} has shape {values.shape}, expected {self.time.shape}")
        if not self.sha256:
            object.__setattr__(self, "sha256", _hash_arrays(self))

    @classmethod
    def from_frame(
        cls,
        frame: pandas.DataFrame,
        *,
        inputs: str | Sequence[str],
        outputs: str | Sequence[str],
        name: str = "recording",
        units: Mapping[str, str] | None = None,
    ) -> Recording:
        """Return a recording from the columns of a data frame, checked as one that is read from a file.

        Parameters
        ----------
        frame : pandas.DataFrame
            Times stand in its column ``time``, or are its index, unless that only numbers its rows: in s, as durations,
            or as dates with or without a time zone, which count from the first.
        inputs, outputs : str or sequence of str
            Its columns that were applied and measured, named as in the model.
        name : str
            What reports call it.
        units : mapping of str to str, optional
            Of the columns, as ``{"T": "degC"}``; a fit converts them to those of its model, which are the others'.

        Returns
        -------
        Recording

        Raises
        ------
        InputError
            For a column that is not there, and for what is wrong in one.

        Examples
        --------
        >>> frame = recording.to_frame()
        >>> aero_bayes.Recording.from_frame(frame, inputs="F", outputs="position", name="train")
        <Recording train: F -> position; 2001 rows, 40 s at 50 Hz>
        """
        import pandas

        from aero_bayes.data.mend import with_steady_clock

        if not hasattr(frame, "columns"):
            raise InputError(f"frame: expected a data frame of pandas, got {type(frame).__name__}")
        roles = [names_of(inputs, "inputs"), names_of(outputs, "outputs")]
        for column in (c for names in roles for c in names):
            if column not in frame.columns:
                raise InputError(f"frame: no column {column}{known_names_hint(column, map(str, frame.columns))}")
            if list(frame.columns).count(column) > 1:
                raise InputError(f"frame: column {column} appears more than once, expected once")
        if "time" not in frame.columns and isinstance(frame.index, pandas.RangeIndex) and frame.index.name is None:
            timed = next((str(c) for c in frame.columns if is_time_name(str(c))), "NAME")
            raise InputError(
                f"frame: no column time, and its index only numbers the rows (columns: "
                f'{", ".join(map(str, frame.columns))}); give its times, as by frame.set_index("{timed}")'
            )
        time, _ = instants(frame["time"] if "time" in frame.columns else frame.index)
        if (unit := (units or {}).get("time", "s")) != "s":
            time = ColumnMap("time", unit).convert(time, "time", "s")
        if is_newest_first(time):
            frame, time = frame.iloc[::-1], time[::-1]
        given, measured = ({c: numbers(frame[c], name, c) for c in names} for names in roles)
        found = with_steady_clock(cls(name, time, given, measured, {**(units or {}), "time": "s"}))
        check_recording(found)
        return found

    @property
    def rows(self) -> int:
        """Number of samples."""
        return int(self.time.size)

    @property
    def rate_hz(self) -> float:
        """Sample rate in Hz, from the median sample interval (0 for a single sample)."""
        return 1.0 / self.interval if self.rows > 1 else 0.0

    @property
    def interval(self) -> float:
        """Median time between samples in s (0 for a single sample)."""
        return float(np.median(np.diff(self.time))) if self.rows > 1 else 0.0

    @property
    def duration(self) -> float:
        """Time from the first to the last sample in s."""
        return float(self.time[-1] - self.time[0]) if self.rows else 0.0

    def measured(self, outputs: tuple[str, ...]) -> FloatArray:
        """Return readings of ``outputs`` side by side, shape (n, m). Raises InputError for one without readings."""
        for output in outputs:
            if output not in self.outputs:
                recorded = ", ".join(self.outputs) or "none"
                raise InputError(f"{self.name}: output {output} was not recorded (recorded: {recorded})")
        return np.column_stack([self.outputs[output] for output in outputs]) if outputs else np.empty((self.rows, 0))

    def slice(self, start: float, stop: float) -> Recording:
        """Return the samples with ``start <= time < stop`` (s), times unchanged. Raises InputError if there is none."""
        keep = (self.time >= start) & (self.time < stop)
        if not keep.any():
            raise InputError(
                f"{self.name}: no sample between {start:g} s and {stop:g} s "
                f"(it runs from {self.time[0]:g} s to {self.time[-1]:g} s)"
            )
        return self.rows_where(keep, f"{self.name} [{start:g} s, {stop:g} s)")

    def without(self, *, after: float) -> Recording:
        """Return the same samples with every output reading from ``after`` (s) on taken out.

        Hold a part back from a fit.
        """
        outputs = {name: np.where(self.time >= after, np.nan, values) for name, values in self.outputs.items()}
        return replace(self, name=f"{self.name} (outputs to {after:g} s)", outputs=outputs, sha256="")

    def plot(self, *, dark: bool = False) -> Picture:
        """Draw inputs and outputs over time.

        Parameters
        ----------
        dark : bool
            Colours for a dark background.

        Returns
        -------
        Picture
            A panel for each column, in its SI unit or a thousandth of it.

        Examples
        --------
        >>> len(recording.plot().panels)  # the force, the position
        2
        """
        return drawn("run_picture", self, dark=dark)

    def summary(self) -> RecordingSummary:
        """Look the recording over; no model is involved.

        Returns
        -------
        RecordingSummary
            Sampling, ranges, resolution and noise of each column, in SI units.

        Examples
        --------
        >>> print(recording.summary())
        train.csv: 2,001 rows, 40 s at 50 Hz, even
          F: -3.93 to 4.67, 16 levels, 16 jumps, 7% of the time at its largest size
          position: -0.1042 to 0.1357, noise 0.0003
        """
        from aero_bayes.data.summary import summary_of

        return summary_of(self)

    def to_frame(self) -> pandas.DataFrame:
        """Return every column by time (s), in SI units.

        Examples
        --------
        >>> recording.to_frame().columns.to_list()
        ['F', 'position']
        """
        import pandas

        return pandas.DataFrame({**self.inputs, **self.outputs}, index=pandas.Index(self.time, name="time"))

    def to_dict(self) -> dict[str, str | int | float]:
        """Return the ``data`` entry of result.json: ``file``, ``sha256``, ``rows``, ``rate_hz``."""
        file = self.path.name if self.path else self.name
        return {"file": file, "sha256": self.sha256, "rows": self.rows, "rate_hz": round(self.rate_hz, 6)}

    def __repr__(self) -> str:
        columns = f"{', '.join(self.inputs)} -> {', '.join(self.outputs)}"
        return f"<Recording {self.name}: {columns}; {self.rows} rows, {self.duration:g} s at {self.rate_hz:g} Hz>"

    def _repr_html_(self) -> str:
        rows = []
        for kind, columns in (("input", self.inputs), ("output", self.outputs)):
            for name, values in columns.items():
                seen = values[np.isfinite(values)]
                span = f"{seen.min():.4g} to {seen.max():.4g}" if seen.size else "no reading"
                rows.append((name, kind, self.units.get(name, ""), span, f"{values.size - seen.size}"))
        caption = f"{self.name}: {self.rows} rows, {self.duration:g} s at {self.rate_hz:g} Hz"
        return table_html(("column", "kind", "unit", "range", "gaps"), rows, caption, self.notes)

    def rows_where(self, keep: NDArray[np.bool_], name: str) -> Recording:
        """Return the samples where ``keep`` (n,) holds, under another name."""
        first = int(np.argmax(keep))
        return replace(
            self,
            name=name,
            first_row=self.first_row + first,
            cuts=tuple(int(np.sum(keep[:row])) for row in self.cuts if keep[:row].any() and keep[row:].any()),
            time=self.time[keep],
            inputs={column: values[keep] for column, values in self.inputs.items()},
            outputs={column: values[keep] for column, values in self.outputs.items()},
            sha256="",
        )


def _hash_arrays(recording: Recording) -> str:
    digest = hashlib.sha256()
    for column, values in {"time": recording.time, **recording.inputs, **recording.outputs}.items():
        digest.update(column.encode() + b"\0" + np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()


#: How long before the first sample the earlier input value is placed, in s: longer than any input delay.
INPUT_LEAD_TIME = 1.0
#: How many times as long as usual the interval of a mean may be before it counts as a gap.
MOST_LONGER = 1.5
#: Share of its largest value within which a signal is at rest.
SHARE_AT_REST = 0.02


def to_experiment(
    recording: Recording,
    outputs: Sequence[str] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    zero_at_rest: Sequence[str] | None = None,
    interpolation: Mapping[str, Interpolation] | Interpolation = "hold",
) -> Experiment:
    """Return the experiment that a simulator runs. Held inputs are reduced to the samples at which they change."""
    names = tuple(outputs) if outputs is not None else tuple(recording.outputs)
    at_rest = bool(zero_at_rest) and _was_at_rest(recording, zero_at_rest or ())
    linear = set(recording.inputs) if interpolation == "linear" else set()
    if not isinstance(interpolation, str):
        linear = {name for name, how in interpolation.items() if how == "linear"}
    signals = tuple(
        InputSignal(name, np.ascontiguousarray(recording.time), np.ascontiguousarray(values), "linear")
        if name in linear
        else _hold_signal(name, recording.time, values, at_rest)
        for name, values in recording.inputs.items()
    )
    return Experiment(
        time=np.ascontiguousarray(recording.time),
        outputs=names,
        inputs=signals,
        start=dict(start or {}),
        measured=recording.measured(names),
        known=recording.known,
        windows={name: _windows(recording.time, recording.means[name]) for name in names if name in recording.means},
    )


def _windows(time: FloatArray, stamp: str) -> FloatArray:
    """Return where the interval of each mean begins and ends (n, 2): beside its neighbour, but where there is a gap."""
    usual = float(np.median(np.diff(time)))
    steps = np.diff(time)
    length = np.where(steps < MOST_LONGER * usual, steps, usual)
    if stamp == "end":
        return np.column_stack([time - np.concatenate([[usual], length]), time])
    return np.column_stack([time, time + np.concatenate([length, [usual]])])


def _hold_signal(name: str, time: FloatArray, values: FloatArray, zero_before: bool) -> InputSignal:
    """Return a piecewise constant input with a point at every change, also at the first sample after zero."""
    keep = np.concatenate(([True], values[1:] != values[:-1]))
    grid, levels = time[keep], values[keep]
    if zero_before and levels[0] != 0.0:
        grid, levels = np.concatenate(([time[0] - INPUT_LEAD_TIME], grid)), np.concatenate(([0.0], levels))
    return InputSignal(name, np.ascontiguousarray(grid), np.ascontiguousarray(levels), "hold")


def _was_at_rest(recording: Recording, zero_at_rest: Sequence[str]) -> bool:
    """Return whether the rig rested before the first sample, when its inputs were zero.

    The first recorded output among ``zero_at_rest`` decides: it rested if that begins at nearly zero. If none of them
    was recorded, the rig counts as at rest."""
    values = next((recording.outputs[name] for name in zero_at_rest if name in recording.outputs), np.empty(0))
    seen, first = (np.abs(part[np.isfinite(part)]) for part in (values, values[:3]))
    return not (first.size and first.min() > SHARE_AT_REST * seen.max())


def with_means(recording: Recording, stamps: Mapping[str, Stamp]) -> Recording:
    """Return the recording with some columns as means over the interval that begins or ends at their time.

    An input is moved to where its interval begins, from where it holds. Of an output, the mean is lost whose interval
    reaches beyond the recording."""
    inputs, outputs, means = dict(recording.inputs), dict(recording.outputs), dict(recording.means)
    for name, stamp in stamps.items():
        if name in inputs and stamp == "end":
            inputs[name] = np.concatenate([inputs[name][1:], inputs[name][-1:]])
        elif name in outputs:
            means[name] = stamp
            outputs[name] = outputs[name].copy()
            outputs[name][0 if stamp == "end" else -1] = np.nan
    return replace(recording, inputs=inputs, outputs=outputs, means=means, sha256="") if stamps else recording
