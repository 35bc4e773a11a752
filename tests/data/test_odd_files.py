"""Files that loggers write in another way than a recording: read rightly, with a note, or refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aero_bayes.config import ColumnSection
from aero_bayes.data.columns import ColumnMap, Layout
from aero_bayes.data.read import read_recording
from aero_bayes.data.recording import Recording
from aero_bayes.declared import ColumnSpec
from aero_bayes.errors import InputError

LAYOUT = Layout.of(["P", "T_amb"], ["T"], {"P": "W", "T_amb": "K", "T": "K"})
TIMES = np.arange(60) * 60.0
POWER = np.repeat([0.0, 1250.5, 400.0], 20)
READ = 300.0 + 20.0 * np.sin(TIMES / 900.0) + np.random.default_rng(1).normal(0.0, 0.05, 60)


def written(path: Path, rows: list[str], head: str = "time,P,T_amb,T") -> Path:
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def rows_of(stamps: list[str], zeros: int = 0, unknown: int = 0) -> list[str]:
    return [
        f"{stamp},{p:.2f},{288 if k >= unknown else 0:.2f},{y if k >= zeros else 0:.3f}"
        for k, (stamp, p, y) in enumerate(zip(stamps, POWER, READ, strict=True))
    ]


def test_newest_row_first_is_read_in_the_order_of_time(tmp_path: Path) -> None:
    seconds = [f"{t:.0f}" for t in TIMES]
    dates = [f"2026-03-02 {t // 3600:02.0f}:{t % 3600 / 60:02.0f}:00" for t in TIMES]
    clocks = [f"{(23 + t // 3600) % 24:02.0f}:{t % 3600 / 60:02.0f}:00" for t in TIMES]  # over midnight
    for stamps in (seconds, dates, clocks):
        found = read_recording(written(tmp_path / "r.csv", rows_of(stamps)[::-1]), layout=LAYOUT)
        np.testing.assert_allclose(found.time - found.time[0], TIMES)
        np.testing.assert_allclose(found.outputs["T"], READ, atol=5e-4)
        np.testing.assert_array_equal(found.inputs["P"], POWER)
        assert any("newest" in note for note in found.notes)
    frame = found.to_frame().iloc[::-1]
    np.testing.assert_array_equal(
        Recording.from_frame(frame, inputs=["P", "T_amb"], outputs="T").outputs["T"], found.outputs["T"]
    )


def test_a_fault_in_a_file_with_the_newest_row_first_is_told_with_its_own_row(tmp_path: Path) -> None:
    rows = rows_of([f"{t:.0f}" for t in TIMES])
    rows[10] = rows[10].rpartition(",")[0] + ",x"
    with pytest.raises(InputError, match="row 51, column T"):
        read_recording(written(tmp_path / "r.csv", rows[::-1]), layout=LAYOUT)


def test_zeros_before_the_first_message_are_no_readings(tmp_path: Path) -> None:
    stamps = [f"{t:.0f}" for t in TIMES]
    found = read_recording(written(tmp_path / "r.csv", rows_of(stamps, 12)), layout=LAYOUT)
    assert found.rows == 60
    assert np.flatnonzero(np.isnan(found.outputs["T"])).tolist() == list(range(12))
    assert [(f.kind, f.signal) for f in found.findings] == [("sentinel", "T")]
    both = read_recording(written(tmp_path / "r.csv", rows_of(stamps, 12, 5)), layout=LAYOUT)
    assert both.rows == 55
    assert both.time[0] == 300.0
    assert both.inputs["T_amb"].min() == 288.0
    assert both.first_row == 7


def test_values_that_the_user_calls_missing_are_none_and_a_rest_at_zero_is_kept(tmp_path: Path) -> None:
    layout = Layout.of(["u"], ["w"])
    rest = np.where(TIMES < 900.0, 0.0, 5.0 * (1.0 - np.exp(-(TIMES - 900.0) / 300.0)))
    for step in (900.0, 840.0):  # the speed answers a step at once, or it moves by itself
        rows = [f"{t:.0f},{float(t >= step):.0f},{w:.4f}" for t, w in zip(TIMES, rest, strict=True)]
        path = written(tmp_path / "r.csv", rows, "time,u,w")
        assert np.isfinite(read_recording(path, layout=layout).outputs["w"]).all()
    late = np.where(TIMES < 300.0, 0.0, 5.0 - 4.0 * np.exp(-(TIMES - 300.0) / 60.0))  # a delayed response to a step
    rows = [f"{t:.0f},1,{w:.4f}" for t, w in zip(TIMES, late, strict=True)]
    found = read_recording(written(tmp_path / "s.csv", rows, "time,u,w"), layout=layout)
    assert np.isfinite(found.outputs["w"]).all()
    found = read_recording(path, {"w": ColumnMap("w", missing=(0.0,))}, layout=layout)
    assert np.isnan(found.outputs["w"]).sum() == np.sum(rest == 0.0)
    assert ColumnSection.model_validate({"missing": [0]}).missing == (0.0,)


@pytest.mark.parametrize("form", ["{:.2f} degC", "{:.2f}°C", '"{:.2f} °C"'])
def test_numbers_with_their_unit_behind_them(tmp_path: Path, form: str) -> None:
    rows = [f"{t:.0f},{p:.1f} W,288 K,{form.format(y - 273.15)}" for t, p, y in zip(TIMES, POWER, READ, strict=True)]
    found = read_recording(written(tmp_path / "r.csv", rows), layout=LAYOUT)
    np.testing.assert_allclose(found.outputs["T"], READ, atol=6e-3)
    np.testing.assert_array_equal(found.inputs["P"], POWER)
    rows[7] = "420,0.0 W,288 K,12.5"
    with pytest.raises(InputError, match=r"row 9, column T: .12\.5."):
        read_recording(written(tmp_path / "r.csv", rows), layout=LAYOUT)


def test_words_stand_for_the_values_of_a_switch_and_of_an_enumeration(tmp_path: Path) -> None:
    modes = ColumnSpec("mode", words={"low": 1.0, "high": 3.0}, whole=True)
    layout = Layout((ColumnSpec("on", words={"false": 0.0, "true": 1.0}, whole=True), modes), (ColumnSpec("T", "K"),))
    cells = [("true", "low"), ("FALSE", "Rig.Mode.high"), ("1", "1"), ("0", "3")] * 3
    rows = [f"{k},{on},{mode},{300 + k}" for k, (on, mode) in enumerate(cells)]
    found = read_recording(written(tmp_path / "r.csv", rows, "time,on,mode,T"), layout=layout)
    assert found.inputs["on"][:4].tolist() == [1.0, 0.0, 1.0, 0.0]
    assert found.inputs["mode"][:4].tolist() == [1.0, 3.0, 1.0, 3.0]
    for cell in ("2", "middle", "1.5"):
        rows[2] = f"2,1,{cell},302"
        with pytest.raises(InputError, match="row 4, column mode"):
            read_recording(written(tmp_path / "r.csv", rows, "time,on,mode,T"), layout=layout)
