"""Screen a recording before a model is fitted to it: mend faults of its readings, and tell each with times and rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import (
    MAD_TO_SD,
    MAX_PARTS,
    MIN_PART_ROWS,
    Mask,
    Rows,
    after_changes,
    counter_falls,
    gap_rows,
    noise_size,
    runs,
    typical_step,
    wrapped_rows,
)
from aero_bayes.data.find_table import DataFinding, FindingKind, runs_of, told_numbers
from aero_bayes.data.held import held_period
from aero_bayes.data.noise_floor import quantisation_step
from aero_bayes.data.recording import Recording
from aero_bayes.display import with_unit

#: What loggers and sensors are known to write for a reading that they do not have.
KNOWN_CONSTANTS = frozenset({
    -99999.0, -9999.0, -9999.9, -999.9, -999.0, -99.9, -99.0, 99.9, 99.0, 999.0, 999.9, 9999.0, 9999.9, 99999.0,
    85.0, -127.0, -50.0, 0.0, 32767.0, -32768.0, 65535.0, 3276.7, -3276.8, 6553.5, 2147483647.0, -2147483648.0,
})  # fmt: skip
#: Longest run of a constant that is no reading, in rows; a known one that is impossible may last longer.
MOST_ROWS = 5
#: Largest share of the readings that such constants may be; a signal that is there more often is a signal.
MAX_SHARE = 0.2
#: Distance from both neighbours, in typical steps, from which a constant within the range is far off them.
MIN_STEPS_OFF = 8.0
#: Readings of a constant within the range of the others, and distinct other readings, that it takes.
MIN_REPEATS, MIN_DISTINCT = 3, 5
#: The median step without any one constant, a fifth of the readings at most, is no less than this quantile with it.
LOW_QUANTILE = 0.15
#: Share of a constant's runs that must be far off for a closer look; its runs are split by gaps there.
LEAST_ISOLATED = 0.4
#: Fewest readings that show what is usual.
MIN_SENTINEL_READINGS = 12


def sentinels(values: FloatArray, inputs: Mapping[str, FloatArray]) -> dict[float, Mask]:
    """Mark rows of an output at constants that are no readings, by constant."""
    found: dict[float, Mask] = {}
    left = np.isfinite(values)
    near = after_changes(inputs) if inputs else np.zeros(values.size, dtype=bool)
    for _ in range(MIN_DISTINCT):
        constant = _farthest_outside(values, left, near)
        if constant is None:
            break
        found[constant] = left & (values == constant)
        left &= ~found[constant]
    likely = _likely(values[left])
    for constant in _repeated(values, left):
        if constant not in likely:
            continue
        rows = left & (values == constant)
        if _far_off(values, left, rows, near):
            found[constant] = rows
            left = left & ~rows
            likely = _likely(values[left])
    return found


def _farthest_outside(values: FloatArray, left: Mask, near: Mask) -> float | None:
    """Return the constant that is farthest outside of the range of all others; None if none is impossible."""
    seen = values[left]
    if seen.size < MIN_SENTINEL_READINGS:
        return None
    for constant in (float(seen.min()), float(seen.max())):
        rows = left & (values == constant)
        others = seen[seen != constant]
        count = int(rows.sum())
        if count > MAX_SHARE * seen.size or np.unique(others).size < MIN_DISTINCT:
            continue
        low, high = float(others.min()), float(others.max())
        outside = max(low - constant, constant - high)
        known = constant in KNOWN_CONSTANTS
        if outside <= high - low or not (known or count >= 2):
            continue
        own = runs(rows)
        if not (known and constant != 0.0) and max(stop - start for start, stop in own) > MOST_ROWS:
            continue
        if not known and sum(bool(near[start]) for start, _ in own) > 0.5 * len(own):
            continue
        return constant
    return None


def _repeated(values: FloatArray, left: Mask) -> list[float]:
    """Find constants that occur often enough, and not too often; none for a sensor with coarse steps."""
    seen = values[left]
    if seen.size < MIN_SENTINEL_READINGS:
        return []
    distinct, counts = np.unique(seen, return_counts=True)
    keep = (counts >= MIN_REPEATS) & (counts <= MAX_SHARE * seen.size)
    # Of readings in coarse steps every one is repeated: looking at each would only cost time.
    return [] if keep.sum() > 0.2 * distinct.size + 3 else [float(v) for v in distinct[keep]]


def _likely(seen: FloatArray) -> set[float]:
    """Return the constants that may be far off their neighbours, from one pass over all readings.

    Each is looked at by itself
    at the cost of all readings, and a long recording has a hundred thousand that occur three times."""
    each = seen[np.concatenate(([True], np.diff(seen) != 0.0))]
    if each.size < 3:
        return set()
    step = MAD_TO_SD * float(np.quantile(np.abs(np.diff(seen)), LOW_QUANTILE, method="lower"))
    off = np.minimum(*(np.abs(each[1:-1] - other) for other in (each[:-2], each[2:])))
    apart = (off > MIN_STEPS_OFF * step) & (off > 3.0 * np.abs(each[2:] - each[:-2]))
    distinct, at = np.unique(each[1:-1], return_inverse=True)
    isolated, total = np.bincount(at, apart, distinct.size), np.bincount(at, minlength=distinct.size)
    return set(distinct[(isolated > 0) & (isolated >= LEAST_ISOLATED * total)].tolist())


def _far_off(values: FloatArray, left: Mask, rows: Mask, near: Mask) -> bool:
    """Return whether nearly each run of a constant is short and far off the readings before and after, which agree."""
    at = np.flatnonzero(left & ~rows)
    step = typical_step(values[at])
    isolated = total = 0
    for start, stop in runs(rows):
        total += 1
        place = int(np.searchsorted(at, start))
        if stop - start > MOST_ROWS or near[start] or not 0 < place < at.size:
            continue
        before, after = values[at[place - 1]], values[at[place]]
        off = min(abs(values[start] - before), abs(values[start] - after))
        isolated += bool(off > MIN_STEPS_OFF * step and off > 3.0 * abs(after - before))
    return isolated >= 2 and isolated >= 0.8 * total


#: Fewest equal readings in a row that are stuck, and that are clipped at an extreme.
MIN_STUCK, MIN_CLIPPED = 10, 4
#: Share of neighbouring readings elsewhere that may be equal, in a channel that can be judged.
MAX_EQUAL_SHARE = 0.05
#: Readings before and after a run that must show noise, and how much of the channel's usual one.
BESIDE, MIN_NOISE_SHARE = 20, 0.3
#: Size of third differences over second ones, each over that of white noise, from which readings are noisy.
MIN_NOISE_RATIO = 0.8
#: Jump after a stuck run over an ordinary step, and speed before a clipped one over its change from reading to reading.
MIN_MISSED, MIN_SPEED = 2.0, 5.0
#: Share of the range within which two readings count as one: a print format may differ in the last digit.
SAME = 1e-9


def stuck_rows(values: FloatArray, inputs: Mapping[str, FloatArray]) -> tuple[Mask, Mask]:
    """Mark rows where an output is stuck, and rows where it is clipped."""
    stuck, clipped = np.zeros(values.size, dtype=bool), np.zeros(values.size, dtype=bool)
    at = np.flatnonzero(np.isfinite(values))
    seen = values[at]
    if seen.size < 3 * MIN_STUCK or np.ptp(seen) == 0.0:
        return stuck, clipped
    equal = np.abs(np.diff(seen)) <= SAME * np.ptp(seen)
    spans = [(start, stop + 1) for start, stop in runs(equal)]
    ends = seen.min(), seen.max()
    chosen = [
        (start, stop) for start, stop in spans if stop - start >= (MIN_CLIPPED if seen[start] in ends else MIN_STUCK)
    ]
    inside = np.zeros(seen.size, dtype=bool)
    for start, stop in chosen:
        inside[start:stop] = True
    elsewhere = ~(inside[:-1] | inside[1:])
    if not chosen or elsewhere.sum() < MIN_STUCK or equal[elsewhere].mean() > MAX_EQUAL_SHARE:
        return stuck, clipped
    usual, near = noise_size(seen[~inside]), after_changes(inputs)[at] if inputs else np.zeros(at.size, dtype=bool)
    noisy, begun = _is_noisy(seen[~inside]), np.searchsorted(at, _first_change(inputs))
    ordinary = float(np.quantile(np.abs(np.diff(seen))[elsewhere], 0.95))
    for start, stop in chosen:
        around = np.concatenate([seen[max(start - BESIDE, 0) : start], seen[stop : stop + BESIDE]])
        # What rests before a run begins reads the same by right, and so does what cannot fall below zero.
        if start == 0 or start < begun or usual <= 0.0 or noise_size(around) < MIN_NOISE_SHARE * usual:
            continue
        if not (noisy or _missed(seen, stop, ordinary) or (seen[start] in ends and _abrupt(seen, start))):
            continue
        if seen[start] in ends and seen[start] != 0.0:
            clipped[at[seen == seen[start]]] = True
        elif seen[start] != 0.0 or (not near[start] and _jumps(seen, start, stop, usual)):
            stuck[at[start + 1 : stop]] = True
    return stuck, clipped


def _is_noisy(values: FloatArray) -> bool:
    """Return whether each reading has noise: then third differences are as large as second ones, and not rounded."""
    if values.size < 3 * MIN_STUCK or quantisation_step(values) is not None:
        return False
    third = MAD_TO_SD * float(np.median(np.abs(np.diff(values, 3)))) / math.sqrt(20.0)
    return third > MIN_NOISE_RATIO * noise_size(values)


def _first_change(inputs: Mapping[str, FloatArray]) -> int:
    """Return the row at which an input first changes; 0 where none does."""
    rows = [int(np.argmax(values != values[0])) for values in inputs.values()]
    return min((row for row in rows if row), default=0)


def _missed(seen: FloatArray, stop: int, ordinary: float) -> bool:
    """Return whether the reading after a run jumps to what the sensor missed."""
    return stop < seen.size and abs(float(seen[stop] - seen[stop - 1])) > MIN_MISSED * ordinary


def _abrupt(seen: FloatArray, start: int) -> bool:
    """Return whether a run begins at full speed: what comes to rest slows down before."""
    if start < 3:
        return False
    before, last = float(seen[start - 2] - seen[start - 3]), float(seen[start - 1] - seen[start - 2])
    return abs(last) > MIN_SPEED * abs(last - before)


def _jumps(seen: FloatArray, start: int, stop: int, usual: float) -> bool:
    """Return whether a run begins and ends with a jump: a flow that was shut off rests at zero by right."""
    before = abs(seen[start] - seen[start - 1]) if start else np.inf
    after = abs(seen[stop] - seen[stop - 1]) if stop < seen.size else np.inf
    return bool(min(before, after) > 10.0 * usual)


def from_first_message(recording: Recording, raw: Mapping[str, FloatArray], filled: Sequence[str]) -> Recording:
    """Return the recording without the constants that a logger writes until a sensor's first message comes.

    ``raw`` are columns as they stand in the file. Outputs have a gap there. The recording begins where every input is
    known; ``filled`` are inputs with gaps in which the value before holds."""
    first = 0
    for name, values in raw.items():
        own, is_input = {**recording.inputs, **recording.outputs}[name], name in recording.inputs
        rows = int(np.argmax(values != values[0]))
        if recording.units.get(name) != "K" or own[0] != 0.0:
            # A command rests at zero by right.
            others = {n: v for n, v in recording.inputs.items() if n != name}
            rows = 0 if is_input and values[0] == 0.0 else _before_first_message(values, rows, others)
        if not rows:
            continue
        role = f"values of the input {name}" if is_input else f"readings of {name}"
        what = (
            f"The first {rows} {role} are exactly {values[0]:.7g}, far off all others: its sensor has sent nothing yet."
        )
        keep = f"[data.columns.{name}] missing = [] would keep them."
        mask = np.arange(recording.rows) < rows
        if is_input:
            first, done = max(first, rows), f"The recording begins behind them; {keep}"
            recording = _told(recording, "sentinel", name, what, _where(recording, mask), done)
        else:
            recording = hide(recording, name, mask, "sentinel", what, f"They are not fitted; {keep}")
    for name in filled:
        there = np.isfinite(recording.inputs[name])
        if there.any():
            first, recording = max(first, int(np.argmax(there))), _held_between(recording, name, there)
    return recording.rows_where(np.arange(recording.rows) >= first, recording.name) if first else recording


def _held_between(recording: Recording, name: str, known: Mask) -> Recording:
    """Return the recording with an input that holds between the rows at which it is known."""
    rows = np.flatnonzero(known)
    before = rows[np.clip(np.searchsorted(rows, np.arange(known.size), side="right") - 1, 0, None)]
    return replace(recording, inputs={**recording.inputs, name: recording.inputs[name][before]})


def with_counters(recording: Recording, raw: Mapping[str, FloatArray]) -> Recording:
    """Return the recording with findings for counters that roll over or are reset; ``raw`` are columns of the file."""
    for name, values in raw.items():
        own = {**recording.inputs, **recording.outputs}[name]
        falls = None if wrapped_rows(own, recording.units.get(name, "")).size else counter_falls(values)
        if falls is not None:
            (rows, modulus), how, setting = falls, "is reset", "reset = true"
            if modulus is not None:
                power, setting = math.log2(modulus), f"unwrap = {modulus:.9g}"
                how = f"rolls over at {modulus:.9g}{f' = 2^{power:.0f}' if power.is_integer() else ''}"
            what = f"{name} counts up and falls to about zero {int(rows.sum())} times: its counter {how}."
            done = f"Let it go on by [data.columns.{name}] {setting}."
            recording = _told(recording, "wrapped", name, what, _where(recording, rows), done, mended=False)
    return recording


def _before_first_message(values: FloatArray, rows: int, inputs: Mapping[str, FloatArray]) -> int:
    """Return the number of rows at the beginning that hold a constant if it stands for no reading, else zero.

    It is a known one that is farther outside of all others than these range. A change of an input may be the cause of
    the jump there, and a response to a step that began before has readings in between."""
    rest = values[rows:][np.isfinite(values[rows:])]
    if not rows or values[0] not in KNOWN_CONSTANTS or rest.size < max(MIN_SENTINEL_READINGS, rows):
        return 0
    if values[0] in rest or np.unique(rest).size < MIN_DISTINCT or (inputs and after_changes(inputs)[rows]):
        return 0
    outside = max(float(rest.min() - values[0]), float(values[0] - rest.max()))
    return rows if outside > np.ptp(rest) else 0


def mend(recording: Recording) -> tuple[Recording, ...]:
    """Mend what is wrong with the readings of a recording.

    Readings that are no readings (constants that stand for none, a stuck or clipped sensor) become gaps. A recording
    whose logger lost a stretch is cut there, since what its inputs did is not known."""
    return _parts(_without_wrong_readings(_with_possible_inputs(recording)))


def hide(
    recording: Recording, output: str, rows: Mask, kind: FindingKind, what: str, done: str = "They are not fitted."
) -> Recording:
    """Return the recording without some readings of an output, and with a finding that says so."""
    outputs = {**recording.outputs, output: np.where(rows, np.nan, recording.outputs[output])}
    return _told(replace(recording, outputs=outputs), kind, output, what, _where(recording, rows), done)


def _told(
    recording: Recording, kind: FindingKind, signal: str, what: str, where: str, done: str, mended: bool = True
) -> Recording:
    """Return the recording with a finding more."""
    source = recording.path.name if recording.path is not None else recording.name
    finding = DataFinding(kind, recording.name, signal, what, f"{source}{where}", done, mended)
    return replace(recording, findings=(*recording.findings, finding))


def _where(recording: Recording, rows: Mask) -> str:
    """Write times and rows in a sentence."""
    at = np.flatnonzero(rows)
    return f": at {told_numbers(recording.time[at].tolist(), 's')}; rows {_numbers(recording, at)}"


def _numbers(recording: Recording, rows: Rows) -> str:
    """Write the numbers of rows in the file; in one with the newest row first they count back from the last."""
    return runs_of(np.sort(np.abs(rows + recording.first_row)).tolist())


def _with_possible_inputs(recording: Recording) -> Recording:
    """Return the recording with inputs held where the logger wrote a known constant that is impossible."""
    for name, values in recording.inputs.items():
        constant = _farthest_outside(values, np.isfinite(values), np.zeros(values.size, dtype=bool))
        if constant in KNOWN_CONSTANTS - {0.0}:
            rows = values == constant
            what = f"{int(rows.sum())} values of the input {name} are exactly {constant:.7g}"
            what = f"{with_unit(what, recording.units.get(name, ''))}, which is impossible."
            recording = _held_between(recording, name, ~rows)
            done = "The value before is held there."
            recording = _told(recording, "sentinel", name, what, _where(recording, rows), done)
    return recording


def _without_wrong_readings(recording: Recording) -> Recording:
    """Return the recording without readings that are none, and with a finding for an angle that wraps."""
    for name in recording.outputs:
        if (held := held_period(recording.outputs[name], recording.inputs)) is not None:
            recording = _once(recording, name, *held)
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


def _once(recording: Recording, name: str, period: float, came: Mask) -> Recording:
    """Return the recording with each reading of a sensor that sends rarely once, where it came."""
    recording = replace(recording, outputs={**recording.outputs, name: np.where(came, recording.outputs[name], np.nan)})
    what = f"{name} is sent every {period * recording.interval:.4g} s and repeated in the rows between"
    return _told(recording, "held", name, what, "", f"Its {int(came.sum())} readings count once, where they came.")


def _with_told(recording: Recording, name: str, unit: str) -> Recording:
    """Return the recording with findings for what only the user can mend.

    An angle that wraps, a channel that never moves."""
    values = recording.outputs[name]
    known = {(f.kind, f.signal) for f in recording.findings}
    rows = np.zeros(recording.rows, dtype=bool)
    rows[wrapped_rows(values, unit)] = True
    if rows.any() and ("wrapped", name) not in known:
        what = f"{name} jumps by a whole turn {int(rows.sum())} times: the sensor counts modulo one turn."
        done = f"Unwrap it by [data.columns.{name}] unwrap = true."
        recording = _told(recording, "wrapped", name, what, _where(recording, rows), done, mended=False)
    seen = values[np.isfinite(values)]
    moves = any(np.ptp(given) > 0.0 for given in recording.inputs.values())
    if seen.size >= MIN_PART_ROWS and np.ptp(seen) == 0.0 and moves and ("stuck", name) not in known:
        what = f"{name} reads {seen[0]:.7g} throughout: its sensor is stuck, or its column holds something else."
        recording = _told(recording, "stuck", name, what, "", "Leave the column out.", mended=False)
    return recording


def _parts(recording: Recording) -> tuple[Recording, ...]:
    """Return the recording cut at its gaps; parts of a few samples are left out."""
    gaps = gap_rows(recording.time, recording.inputs)
    rows = np.union1d(gaps, np.array(recording.cuts, dtype=np.intp))
    spans = [(a, b) for a, b in pairwise([0, *rows.tolist(), recording.rows]) if b - a >= MIN_PART_ROWS]
    if rows.size == 0 or not spans:
        return (recording,)
    lost = recording.rows - sum(b - a for a, b in spans)
    left = f" {lost} samples in parts of fewer than {MIN_PART_ROWS} are left out." if lost else ""
    whole = recording
    if gaps.size:
        times = ", ".join(f"{recording.time[r - 1]:.6g} s to {recording.time[r]:.6g} s" for r in gaps)
        what = f"The logger has no sample from {times}; the inputs are not known there."
        done = f"Each part begins anew with its own initial state.{left}"
        whole = _told(recording, "gap", "", what, f": before rows {_numbers(recording, gaps)}", done)
    found = []
    for k, (a, b) in enumerate(spans):
        keep = np.zeros(recording.rows, dtype=bool)
        keep[a:b] = True
        part = whole.rows_where(keep, f"{recording.name} (part {k + 1})" if len(spans) > 1 else recording.name)
        found.append(replace(part, resumes=a > 0, part_of=recording.name, cuts=()))
    return tuple(found)


def with_steady_clock(recording: Recording) -> Recording:
    """Return the recording with the time after each step back of its clock moved behind the time before it.

    How long the step took is not known, so that what follows it is marked as a part that begins anew. A clock that
    steps back so often that its parts are short is left to be refused."""
    rows = _steps_back(recording.time)
    if rows.size == 0:
        return recording
    usual = float(np.median(np.diff(recording.time)))
    time, told = recording.time.copy(), []
    for row in rows.tolist():
        told.append(f"from {recording.time[row - 1]:.9g} s to {recording.time[row]:.9g} s")
        time[row:] += time[row - 1] + usual - time[row]
    steady = replace(recording, time=time, cuts=tuple(sorted({*recording.cuts, *rows.tolist()})))
    done = "What follows is a part that begins anew with its own initial state; times go on from the one before."
    what = f"The clock steps back {', '.join(told)}."
    return _told(steady, "clock", "", what, f": rows {_numbers(recording, rows)}", done)


def _steps_back(time: FloatArray) -> Rows:
    """Find the first rows after a step back of the clock, where all parts between them are long enough for a fit."""
    none = np.empty(0, dtype=np.intp)
    if not np.isfinite(time).all() or time.size < 2 * MIN_PART_ROWS:
        return none
    rows = np.flatnonzero(np.diff(time) < 0.0) + 1
    if any(row + 1 < time.size and time[row + 1] > time[row - 1] for row in rows.tolist()):
        return none  # one wrong number: the clock goes on as before
    lengths = np.diff(np.concatenate(([0], rows, [time.size])))
    return rows if rows.size < MAX_PARTS and lengths.min() >= MIN_PART_ROWS else none
