"""A clock that steps back: a recording goes on after the step as a new part, on a time that does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aero_bayes.data.columns import MAX_PARTS, MIN_PART_ROWS, Rows
from aero_bayes.data.find_table import DataFinding, runs_of
from aero_bayes.data.recording import Recording


def with_steady_clock(recording: Recording) -> Recording:
    """Return the recording with the time after each step back of its clock moved behind the time before it.

    How long the step took is not known, so that what follows it is marked as a part that begins anew. A clock that
    steps back so often that its parts are short is left to be refused."""
    rows = _steps_back(recording)
    if rows.size == 0:
        return recording
    usual = float(np.median(np.diff(recording.time)))
    time, told = recording.time.copy(), []
    for row in rows.tolist():
        told.append(f"from {recording.time[row - 1]:.9g} s to {recording.time[row]:.9g} s")
        time[row:] += time[row - 1] + usual - time[row]
    finding = DataFinding(
        "clock", recording.name, "", f"The clock steps back {', '.join(told)}.",
        f"{recording.path.name if recording.path else recording.name}: rows "
        f"{runs_of((rows + recording.first_row).tolist())}",
        "What follows is a part that begins anew with its own initial state; times go on from the one before.", True,
    )  # fmt: skip
    cuts = tuple(sorted({*recording.cuts, *rows.tolist()}))
    return replace(recording, time=time, cuts=cuts, findings=(*recording.findings, finding))


def _steps_back(recording: Recording) -> Rows:
    """Find the first rows after a step back of the clock, where all parts between them are long enough for a fit."""
    time = recording.time
    if not np.isfinite(time).all() or time.size < 2 * MIN_PART_ROWS:
        return np.empty(0, dtype=np.intp)
    rows = np.flatnonzero(np.diff(time) < 0.0) + 1
    if any(row + 1 < time.size and time[row + 1] > time[row - 1] for row in rows.tolist()):
        return np.empty(0, dtype=np.intp)  # one wrong number: the clock goes on as before
    lengths = np.diff(np.concatenate(([0], rows, [time.size])))
    return rows if rows.size < MAX_PARTS and lengths.min() >= MIN_PART_ROWS else np.empty(0, dtype=np.intp)
