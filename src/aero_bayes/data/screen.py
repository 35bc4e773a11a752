"""Screen a recording before a model is fitted to it: mend faults of its readings, and tell each with times and rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from aero_bayes.data.findings import DataFinding, FindingKind, runs_of, told_numbers
from aero_bayes.data.gaps import MIN_PART_ROWS, gap_rows
from aero_bayes.data.recording import Recording
from aero_bayes.data.runs import Mask
from aero_bayes.data.sentinels import impossible_inputs, sentinels
from aero_bayes.data.stuck import stuck_rows
from aero_bayes.data.wrapped import wrapped_rows
from aero_bayes.display import with_unit


def screen(recording: Recording) -> tuple[Recording, ...]:
    """Mend what is wrong with the readings of a recording.

    Readings that are no readings (constants that stand for none, a stuck or clipped sensor) become gaps. A recording
    whose logger lost a stretch is cut there, since what its inputs did is not known."""
    return _parts(_without_wrong_readings(_with_possible_inputs(recording)))


def screen_all(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Return the screened parts of recordings, in order."""
    return tuple(part for recording in recordings for part in screen(recording))


def hide(recording: Recording, output: str, rows: Mask, kind: FindingKind, what: str, done: str = "") -> Recording:
    """Return the recording without some readings of an output, and with a finding that says so."""
    values = np.where(rows, np.nan, recording.outputs[output])
    finding = DataFinding(
        kind, recording.name, output, what, where(recording, rows), done or "They are not fitted.", True
    )
    return replace(recording, outputs={**recording.outputs, output: values}, findings=(*recording.findings, finding))


def where(recording: Recording, rows: Mask) -> str:
    """Write times and rows in a sentence."""
    at = np.flatnonzero(rows)
    numbers = runs_of((at + recording.first_row).tolist())
    return f"{_source(recording)}: at {told_numbers(recording.time[at].tolist(), 's')}; rows {numbers}"


def _source(recording: Recording) -> str:
    """Return the file, or the name of arrays."""
    return recording.path.name if recording.path is not None else recording.name


def _with_possible_inputs(recording: Recording) -> Recording:
    """Return the recording with inputs held where the logger wrote a constant that is no value of them."""
    for name, values in recording.inputs.items():
        for constant, rows in impossible_inputs(values).items():
            kept = np.flatnonzero(~rows)
            before = kept[np.clip(np.searchsorted(kept, np.arange(values.size), side="right") - 1, 0, None)]
            unit = recording.units.get(name, "")
            what = with_unit(f"{int(rows.sum())} values of the input {name} are exactly {constant:.7g}", unit)
            finding = DataFinding(
                "sentinel", recording.name, name, f"{what}, which is impossible.", where(recording, rows),
                "The value before is held there.", True,
            )  # fmt: skip
            recording = replace(
                recording,
                inputs={**recording.inputs, name: values[before]},
                findings=(*recording.findings, finding),
            )
    return recording


def _without_wrong_readings(recording: Recording) -> Recording:
    """Return the recording without readings that are none, and with a finding for an angle that wraps."""
    for name in recording.outputs:
        unit = recording.units.get(name, "")
        for constant, rows in sentinels(recording.outputs[name], recording.inputs).items():
            what = with_unit(f"{int(rows.sum())} readings of {name} are exactly {constant:.7g}", unit)
            recording = hide(recording, name, rows, "sentinel", f"{what}, far off all others.")
        stuck, clipped = stuck_rows(recording.outputs[name], recording.inputs)
        if stuck.any():
            what = f"The sensor of {name} is stuck: {int(stuck.sum())} readings repeat the one before."
            recording = hide(recording, name, stuck, "stuck", what)
        if clipped.any():
            what = f"{name} is clipped: {int(clipped.sum())} readings are at an end of its range."
            recording = hide(recording, name, clipped, "clipped", what)
        recording = _with_told(recording, name, unit)
    return recording


def _with_told(recording: Recording, name: str, unit: str) -> Recording:
    """Return the recording with findings for what only the user can mend.

    An angle that wraps, a channel that never moves."""
    values = recording.outputs[name]
    told = {(f.kind, f.signal) for f in recording.findings}
    rows = np.zeros(recording.rows, dtype=bool)
    rows[wrapped_rows(values, unit)] = True
    if rows.any() and ("wrapped", name) not in told:
        what = f"{name} jumps by a whole turn {int(rows.sum())} times: the sensor counts modulo one turn."
        done = f"Unwrap it by [data.columns.{name}] unwrap = true."
        finding = DataFinding("wrapped", recording.name, name, what, where(recording, rows), done, False)
        recording = replace(recording, findings=(*recording.findings, finding))
    seen = values[np.isfinite(values)]
    moves = any(np.ptp(given) > 0.0 for given in recording.inputs.values())
    if seen.size >= MIN_PART_ROWS and np.ptp(seen) == 0.0 and moves and ("stuck", name) not in told:
        what = f"{name} reads {seen[0]:.7g} throughout: its sensor is stuck, or its column holds something else."
        finding = DataFinding("stuck", recording.name, name, what, _source(recording), "Leave the column out.", False)
        recording = replace(recording, findings=(*recording.findings, finding))
    return recording


def _parts(recording: Recording) -> tuple[Recording, ...]:
    """Return the recording cut at its gaps; parts of a few samples are left out."""
    gaps = gap_rows(recording.time, recording.inputs)
    rows = np.union1d(gaps, np.array(recording.cuts, dtype=np.intp))
    if rows.size == 0:
        return (recording,)
    edges = [0, *rows.tolist(), recording.rows]
    spans = [(a, b) for a, b in pairwise(edges) if b - a >= MIN_PART_ROWS]
    if not spans:
        return (recording,)
    lost = recording.rows - sum(b - a for a, b in spans)
    left = f" {lost} samples in parts of fewer than {MIN_PART_ROWS} are left out." if lost else ""
    findings = recording.findings
    if gaps.size:
        times = ", ".join(f"{recording.time[r - 1]:.6g} s to {recording.time[r]:.6g} s" for r in gaps)
        gap = DataFinding(
            "gap", recording.name, "", f"The logger has no sample from {times}; the inputs are not known there.",
            f"{_source(recording)}: before rows {runs_of((gaps + recording.first_row).tolist())}",
            f"Each part begins anew with its own initial state.{left}", True,
        )  # fmt: skip
        findings = (*findings, gap)
    found = []
    for k, (a, b) in enumerate(spans):
        keep = np.zeros(recording.rows, dtype=bool)
        keep[a:b] = True
        name = f"{recording.name} (part {k + 1})" if len(spans) > 1 else recording.name
        part = recording.rows_where(keep, name)
        found.append(replace(part, findings=findings, resumes=a > 0, part_of=recording.name, cuts=()))
    return tuple(found)
