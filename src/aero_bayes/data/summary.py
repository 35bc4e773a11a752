"""Summary of a recording: sampling, inputs, and resolution and noise of each output. `aero-bayes check` prints it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aero_bayes.data.held import held_period
from aero_bayes.data.mend import stuck_rows
from aero_bayes.data.noise_floor import NoiseFloor, output_noise_floor
from aero_bayes.data.recording import Recording
from aero_bayes.display import table_html, with_unit


@dataclass(frozen=True)
class InputSummary:
    """An input: its range, its jumps, and the share of time at its largest magnitude."""

    name: str
    unit: str
    lowest: float
    highest: float
    levels: int
    jumps: int
    at_largest: float

    @property
    def text(self) -> str:
        """One line."""
        if self.levels == 1:
            return with_unit(f"{self.name}: constant at {self.lowest:.5g}", self.unit)
        what = f"{self.levels} levels" if self.levels <= 50 else "varies continuously"
        span = with_unit(f"{self.name}: {self.lowest:.5g} to {self.highest:.5g}", self.unit)
        return f"{span}, {what}, {self.jumps} jumps, {self.at_largest:.0%} of the time at its largest size"


@dataclass(frozen=True)
class OutputSummary:
    """An output: range, missing readings, share of saturated readings, time for which each is repeated, noise floor."""

    name: str
    unit: str
    lowest: float
    highest: float
    missing: int
    longest_gap: float
    saturated: float
    held: float
    noise: NoiseFloor

    @property
    def text(self) -> str:
        """One line."""
        noise = self.noise
        told = f"noise unknown (at most {noise.at_most:.2g})" if noise.sd is None else f"noise {noise.sd:.2g}"
        parts = [with_unit(f"{self.name}: {self.lowest:.4g} to {self.highest:.4g}", self.unit), told]
        if noise.slow > 0.0:
            parts[-1] += f" (white {noise.white:.2g}, slow {noise.slow:.2g} over {noise.slow_time:.2g} s)"
        if noise.quantum is not None:
            parts.append(f"step {noise.quantum:.4g}")
        if self.missing:
            parts.append(f"{self.missing} readings missing (longest gap {self.longest_gap:.3g} s)")
        if self.held > 0.0:
            parts.append(f"sent every {self.held:.4g} s and repeated in between")
        if self.saturated > 0.0:
            parts.append(f"saturated: {self.saturated:.1%} of the readings stuck at an extreme")
        return ", ".join(parts)


@dataclass(frozen=True)
class RecordingSummary:
    """A recording at a glance.

    ``jitter`` is the standard deviation of the sample interval over its median; ``dropped`` counts the samples that
    are missing in intervals of more than 1.5 medians."""

    name: str
    rows: int
    duration: float
    rate_hz: float
    jitter: float
    dropped: int
    longest_interval: float
    inputs: tuple[InputSummary, ...]
    outputs: tuple[OutputSummary, ...]

    def __str__(self) -> str:
        even = "even" if self.jitter < 1e-3 else f"jitter {self.jitter:.1%}"
        first = f"{self.name}: {self.rows:,} rows, {self.duration:.6g} s at {self.rate_hz:.6g} Hz, {even}"
        if self.dropped:
            first += f", {self.dropped} samples missing (longest interval {self.longest_interval:.3g} s)"
        return "\n  ".join([first, *(one.text for one in self.inputs), *(one.text for one in self.outputs)])

    def __repr__(self) -> str:
        return f"<Summary {str(self).partition(chr(10))[0]}>"

    def _repr_html_(self) -> str:
        first, *columns = str(self).splitlines()
        return table_html(("column",), [(line.strip(),) for line in columns], first)


def summary_of(recording: Recording) -> RecordingSummary:
    """Return the summary of a recording that passed the checks of reading."""
    intervals = np.diff(recording.time)
    median = float(np.median(intervals))
    return RecordingSummary(
        name=recording.path.name if recording.path else recording.name,
        rows=recording.rows,
        duration=recording.duration,
        rate_hz=recording.rate_hz,
        jitter=float(np.std(intervals[intervals <= 1.5 * median]) / median),
        dropped=int(np.sum(np.rint(intervals[intervals > 1.5 * median] / median) - 1.0)),
        longest_interval=float(intervals.max()),
        inputs=tuple(_input(recording, name) for name in recording.inputs),
        outputs=tuple(_output(recording, name) for name in recording.outputs),
    )


def _input(recording: Recording, name: str) -> InputSummary:
    values = recording.inputs[name]
    largest = np.abs(values).max()
    return InputSummary(
        name=name,
        unit=recording.units.get(name, ""),
        lowest=float(values.min()),
        highest=float(values.max()),
        levels=int(np.unique(values).size),
        jumps=int(np.count_nonzero(np.diff(values))),
        at_largest=float((np.abs(values) >= largest * (1.0 - 1e-9)).mean()),
    )


def _output(recording: Recording, name: str) -> OutputSummary:
    values = recording.outputs[name]
    seen = np.isfinite(values)
    at = recording.time[seen]
    held = held_period(values, recording.inputs)
    return OutputSummary(
        name=name,
        unit=recording.units.get(name, ""),
        lowest=float(values[seen].min()),
        highest=float(values[seen].max()),
        missing=int((~seen).sum()),
        longest_gap=float(np.diff(at).max()) if not seen.all() else 0.0,
        saturated=float(stuck_rows(values, recording.inputs)[1][seen].mean()),
        held=held[0] * recording.interval if held is not None else 0.0,
        noise=output_noise_floor(recording if held is None else recording.rows_where(held[1], recording.name), name),
    )
