"""Faults of readings are found where they were put, told with times and rows, and nothing is found elsewhere."""

from __future__ import annotations

from dataclasses import replace

import heated_room
import numpy as np
import pytest

from aero_bayes.data import Recording, mend
from aero_bayes.data.find_table import DataFinding

pytestmark = pytest.mark.fast


TIMES = heated_room.recording().time
#: Rows 200 to 259.
LATER = (np.arange(TIMES.size) >= 200) & (np.arange(TIMES.size) < 260)


def only(recording: Recording) -> tuple[Recording, DataFinding]:
    """The one part and the one finding of a recording."""
    (part,) = mend(recording)
    (finding,) = part.findings
    return part, finding


def kinds(recording: Recording) -> set[str]:
    return {finding.kind for part in mend(recording) for finding in part.findings}


def put(rows: slice | list[int], value: float) -> Recording:
    def change(readings: np.ndarray) -> np.ndarray:
        readings[rows] = value
        return readings

    return heated_room.with_readings(heated_room.recording(), change)


@pytest.mark.parametrize("value", [-999.0, 85.0, 0.0, 1234.5])
def test_a_constant_that_is_no_reading(value: float) -> None:
    part, finding = only(put([50, 51, 300], value))
    assert (finding.kind, finding.signal, finding.mended) == ("sentinel", "T", True)
    assert np.flatnonzero(np.isnan(part.outputs["T"])).tolist() == [50, 51, 300]
    assert f"{value:g}" in finding.what
    assert "6000, 6120, 36000 s" in finding.where
    assert "51 to 52, 301" in finding.where


def test_an_impossible_value_of_an_input_is_held() -> None:
    given = heated_room.recording()
    outside = given.inputs["T_amb"].copy()
    outside[[70, 71]] = -999.0
    (part,) = mend(Recording("run", given.time, {**given.inputs, "T_amb": outside}, given.outputs, given.units))
    assert part.inputs["T_amb"][[70, 71]].tolist() == [given.inputs["T_amb"][69]] * 2
    assert [f.signal for f in part.findings] == ["T_amb"]


@pytest.mark.parametrize(("kind", "mended", "change", "hidden"), [
    ("stuck", True, lambda y: np.where(LATER, y[199], y), LATER),
    ("clipped", True, lambda y: np.minimum(y, np.quantile(y, 0.9)), None),
    ("stuck", False, lambda y: np.full_like(y, 290.0), ~np.isfinite(TIMES)),  # it never moves: told only
])  # fmt: skip
def test_a_stuck_or_clipped_sensor(kind: str, mended: bool, change, hidden: np.ndarray | None) -> None:
    given = heated_room.recording().outputs["T"]
    part, finding = only(heated_room.with_readings(heated_room.recording(), change))
    assert (finding.kind, finding.mended) == (kind, mended)
    expected = given >= np.quantile(given, 0.9) if hidden is None else hidden
    assert (np.isnan(part.outputs["T"]) == expected).all()


def without_rows(recording: Recording, first: int, last: int) -> Recording:
    keep = np.ones(recording.rows, dtype=bool)
    keep[first:last] = False
    return recording.rows_where(keep, "run")


def test_a_recording_is_cut_at_a_gap() -> None:
    first, second = mend(without_rows(heated_room.recording(), 200, 290))
    assert (first.rows, second.rows) == (200, 310)
    assert (first.resumes, second.resumes) == (False, True)
    assert first.findings == second.findings
    assert first.findings[0].kind == "gap"
    assert "23880 s to 34800 s" in first.findings[0].what
    assert "201" in first.findings[0].where
    assert mend(second) == (second,)


def test_what_inputs_did_is_known_where_they_were_constant_or_a_logger_writes_changes() -> None:
    given = heated_room.recording()
    still = replace(given, inputs={name: np.full(given.rows, 5.0) for name in given.inputs})
    changes = given.rows_where(np.random.default_rng(4).random(given.rows) < 0.1, "run")
    for whole in (without_rows(still, 200, 290), changes):
        assert len(mend(whole)) == 1


@pytest.mark.parametrize(("unit", "turn"), [("rad", 2.0 * np.pi), ("deg", 360.0)])
def test_an_angle_that_wraps(unit: str, turn: float) -> None:
    time = 0.01 * np.arange(1000)
    angle = np.mod(turn * 0.35 * time**1.3, turn) + 1e-3 * np.random.default_rng(1).standard_normal(1000)
    _, finding = only(Recording("run", time, {"u": np.sin(time)}, {"phi": angle}, {"phi": unit}))
    assert (finding.kind, finding.mended) == ("wrapped", False)
    assert "unwrap = true" in finding.done
    assert mend(Recording("run", time, {"u": np.sin(time)}, {"phi": angle}, {"phi": "m"}))[0].findings == ()


def test_nothing_is_found_in_recordings_without_a_fault() -> None:
    """False alarms are rarer than 1 in 10,000: no reading of noise repeats, and none is eight steps off."""
    for seed in range(40):
        given = heated_room.recording(rows=400, seed=seed)
        assert mend(given) == (given,)
        counted = heated_room.with_readings(given, lambda y: np.round(y, 1))
        assert mend(counted) == (counted,)
        settled = heated_room.with_readings(given, lambda y: 290.0 + np.round(10.0 * np.exp(-0.2 * np.arange(400)), 9))
        assert mend(settled) == (settled,)
    # a flow that a valve shuts off reads zero exactly, and a pulse train has the same height each time
    valve = (np.arange(600) % 60 < 40).astype(float)
    noise = 0.01 * np.random.default_rng(2).standard_normal(600)
    pulses = np.where(np.arange(600) % 100 < 3, 5.0, 1.0)
    outputs = {"q": np.where(valve > 0.0, 3.0 + noise, 0.0), "i": 2.0 * pulses + noise * 0.1}
    given = Recording("run", 0.1 * np.arange(600), {"valve": valve, "pulses": pulses}, outputs)
    assert mend(given) == (given,)


def test_a_clock_that_is_set_back_begins_a_new_part() -> None:
    frame = heated_room.recording().to_frame()
    frame.index = np.where(np.arange(600) < 250, frame.index, frame.index - 3600.0)
    read = Recording.from_frame(frame, inputs=["P", "T_amb"], outputs="T", name="run", units=heated_room.UNITS)
    assert np.all(np.diff(read.time) > 0.0)
    first, second = mend(read)
    assert (first.rows, second.rows) == (250, 350)
    assert (first.resumes, second.resumes) == (False, True)
    (finding,) = second.findings
    assert (finding.kind, finding.mended) == ("clock", True)
    assert "29880 s to 26400 s" in finding.what
    assert "251" in finding.where
    assert mend(read.rows_where(np.arange(600) >= 250, "late"))[0].rows == 350


def test_an_arm_that_friction_holds_is_not_stuck() -> None:
    """It slows down, rests while the command moves on, and starts softly: nothing of that is a fault of the sensor."""
    time = 0.01 * np.arange(300)
    command = np.sin(2.0 * time)
    speed = np.maximum(np.sin(4.0 * time) - 0.5, 0.0)
    angle = 1.3 + np.cumsum(speed) * 0.01
    assert np.count_nonzero(np.diff(angle) == 0.0) > 100
    rested = np.concatenate([np.full(20, 1.3 + 1e-4), angle])
    for readings, given in ((angle, command), (rested, np.concatenate([np.zeros(20), command]))):
        clock = 0.01 * np.arange(readings.size)
        assert not kinds(Recording("arm", clock, {"u": given}, {"phi": readings}, {"phi": "rad"}))


def test_a_sensor_without_noise_that_jumps_to_what_it_missed_was_stuck() -> None:
    time = 0.01 * np.arange(300)
    angle = np.sin(2.0 * time)
    angle[100:140] = angle[100]
    assert kinds(Recording("arm", time, {"u": np.cos(time)}, {"phi": angle}, {"phi": "rad"})) == {"stuck"}
