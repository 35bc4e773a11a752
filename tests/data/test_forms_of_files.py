"""Logs in other forms than plain CSV are read as what they say, or refused in one line; and data frames of any time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pytest
from facts import refusal

from aero_bayes import InputError, Recording, read_recording
from aero_bayes.data import Layout
from aero_bayes.data.columns import ColumnMap

pytestmark = pytest.mark.fast

LAYOUT = Layout.of(["P", "Q"], ["T"], {"P": "W", "Q": "W", "T": "K"})
TIME = 120.0 * np.arange(40)
P, Q = 1000.0 + 500.0 * (np.arange(40) % 3), -0.25 * np.arange(40)
T = 290.0 + 0.125 * np.arange(40)
ROWS = list(zip(TIME, P, Q, T, strict=True))


def german(x: float, decimals: int = 3) -> str:
    return f"{x:,.{decimals}f}".translate(str.maketrans(",.", ".,"))


def clock(t: float) -> str:
    return f"{int(t + 86000) // 3600 % 24:02d}:{int(t + 86000) % 3600 // 60:02d}:{(t + 86000) % 60:06.3f}"


def lines(head: str, row: Callable[[float, float, float, float], str]) -> str:
    return "\n".join([head, *(row(*r) for r in ROWS)]) + "\n"


def summer_time(t: float) -> str:
    """The night in which an hour is there twice."""
    start = pandas.Timestamp("2026-10-24T23:50Z").tz_convert("Europe/Berlin")
    return (start + pandas.Timedelta(seconds=t)).isoformat()


def late(t: float, form: str) -> str:
    """A time of the night from the first to the second of March."""
    return (pandas.Timestamp("2026-03-01T23:30") + pandas.Timedelta(seconds=t)).strftime(form)


FORMS = {
    "sep.csv": lines("sep=;\ntime;P;Q;T", lambda *r: ";".join(f"{x:.3f}".replace(".", ",") for x in r)),
    "spaces.csv": lines("  time    P   Q     T", lambda *r: "  ".join(f"{x:12.4f}" for x in r)),
    "fortran.txt": lines("time P Q T", lambda *r: " ".join(f"{x:.8e}".replace("e", "D") for x in r)),
    "clock.csv": lines("time,P,Q,T", lambda t, *r: f"{clock(t)},{','.join(map(str, r))}"),
    "thousands.csv": lines("time,P,Q,T", lambda t, p, q, y: f'"{t:,.1f}","{p:,.1f}",{q},{y}'),
    "tausend.csv": lines("time;P;Q;T", lambda *r: ";".join(map(german, r))),
    "log.lvm": "LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n\nChannels\t3\n***End_of_Header***\n"
    + lines("time\tP\tQ\tT\tComment", lambda *r: "\t".join(map(str, r))),
    "epoch.csv": lines("time,P,Q,T", lambda t, *r: f"{1792800000000 + int(1000 * t)},{','.join(map(str, r))}"),
    "days.csv": lines("time,P,Q,T", lambda t, *r: f"{46319.75 + t / 86400:.9f},{','.join(map(str, r))}"),
    "rows.csv": lines("tag,timestamp,value", lambda t, p, q, y: f"P,{t},{p}\nQ,{t},{q}\nT,{t},{y}"),
    "clocks.csv": lines("time_P,P,time_Q,Q,time_T,T", lambda t, p, q, y: f"{t},{p},{t},{q},{t},{y}"),
    "units.csv": lines("time;P;Q;T\nmin;kW;W;degC", lambda t, p, q, y: f"{t / 60};{p / 1000};{q};{y - 273.15}"),
    "events.csv": lines('"time","P","Q","T"', lambda t, p, q, y: f"{t},{p + 1},{q},{y}\n{t},{p},{q},{y}"),
    "table.txt": lines(
        "#1\n# of CombiTimeTable\ndouble tab(40,4) # P, Q, T",
        lambda *r: " ".join(map(str, r)) + ("  # start" if r[0] == 0 else ""),
    ),
    "day first.csv": lines("time,P,Q,T", lambda t, *r: f"{late(t, '%d/%m/%Y %H:%M:%S')},{','.join(map(str, r))}"),
    "month first.csv": lines("time,P,Q,T", lambda t, *r: f"{late(t, '%m/%d/%Y %H:%M:%S')},{','.join(map(str, r))}"),
    "am and pm.csv": lines("time,P,Q,T", lambda t, *r: f"{late(t, '%m/%d/%y %I:%M:%S %p')},{','.join(map(str, r))}"),
    "rigol.csv": lines("time,P,Q,T,Increment\ns,W,W,K,1e-6", lambda *r: ",".join(map(str, r)) + ","),
    "names of numbers.csv": lines("time,P,Q,T,1,2,3,4,5", lambda *r: ",".join(map(str, (*r, 1, 2, 3, 4, 5)))),
    "zones.csv": lines("time,P,Q,T", lambda t, *r: f"{summer_time(t)},{','.join(map(str, r))}"),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_form_is_read_right(form: str, tmp_path: Path) -> None:
    (tmp_path / form).write_text(FORMS[form])
    maps = {"P": "tab(2)", "Q": "tab(3)", "T": "tab(4)"} if form == "table.txt" else {}
    found = read_recording(tmp_path / form, {n: ColumnMap(source) for n, source in maps.items()}, layout=LAYOUT)
    assert found.time - found.time[0] == pytest.approx(TIME, abs=1e-3)
    for values, expected in ((found.inputs["P"], P), (found.inputs["Q"], Q), (found.outputs["T"], T)):
        assert values == pytest.approx(expected, abs=1e-3)
    assert found.findings == ()


def test_a_unit_of_time_that_was_given_holds(tmp_path: Path) -> None:
    (tmp_path / "epoch.csv").write_text(FORMS["epoch.csv"])
    found = read_recording(tmp_path / "epoch.csv", {"time": ColumnMap("time", unit="ms")}, layout=LAYOUT)
    assert np.diff(found.time) == pytest.approx(np.diff(TIME))


def test_seconds_far_from_zero_stay_seconds(tmp_path: Path) -> None:
    for start, step in ((40000.0, 0.01), (46319.75, 0.002), (1.7e9, 120.0), (50000.0, 0.5), (43000.0, 1.0 / 256.0)):
        rows = [f"{start + step * k!r},1,1,{y}" for k, y in enumerate(T)]
        (tmp_path / "run.csv").write_text("\n".join(["time,P,Q,T", *rows]))
        assert np.diff(read_recording(tmp_path / "run.csv", layout=LAYOUT).time) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize("column", ["T_quality", "Quality", "T status"])
def test_readings_that_are_marked_as_bad_are_not_fitted(column: str, tmp_path: Path) -> None:
    rows = [f"{t},{p},{q},{0.0 if k in (3, 9) else y},{'Bad' if k in (3, 9) else 'Good'}"
            for k, (t, p, q, y) in enumerate(ROWS)]  # fmt: skip
    (tmp_path / "run.csv").write_text("\n".join([f"time,P,Q,T,{column}", *rows]))
    found = read_recording(tmp_path / "run.csv", layout=LAYOUT)
    assert np.flatnonzero(np.isnan(found.outputs["T"])).tolist() == [3, 9]
    assert [f.kind for f in found.findings] == ["quality"]
    assert "rows 5, 11" in found.findings[0].where


@pytest.mark.parametrize("first", [1, 4])
def test_rows_that_are_marked_as_bad_may_hold_words_only(first: int, tmp_path: Path) -> None:
    layout = Layout.of([], ["P", "T"], {"P": "W", "T": "K"})
    rows = [f"{t},{p},{y},Good" if not first <= k < first + 3 else f"{t},Bad Input,No Data,Bad"
            for k, (t, p, _, y) in enumerate(ROWS, 1)]  # fmt: skip
    (tmp_path / "run.csv").write_text("\n".join(["time,P,T,Quality", *rows]))
    found = read_recording(tmp_path / "run.csv", layout=layout)
    assert found.rows == 40
    assert np.flatnonzero(np.isnan(found.outputs["T"])).tolist() == [first - 1, first, first + 1]


def test_signals_with_clocks_of_their_own_come_to_one_time(tmp_path: Path) -> None:
    """Inputs hold until their next reading, outputs are missing between theirs."""
    rows = [f"P,{t},{t}" for t in range(0, 60, 3)] + [f"Q,{t},1" for t in (1, 30)] + [f"T,{t},{t}" for t in range(50)]
    (tmp_path / "run.csv").write_text("\n".join(["signal,time,value", *rows]))
    found = read_recording(tmp_path / "run.csv", layout=LAYOUT)
    assert found.time[[0, -1]].tolist() == [1.0, 57.0]
    assert found.inputs["P"] == pytest.approx(3.0 * np.floor(found.time / 3.0))
    read = np.isfinite(found.outputs["T"])
    assert found.time[read].tolist() == list(range(1, 50))
    assert found.outputs["T"][read] == pytest.approx(found.time[read])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            lines("tag,time,a,b", lambda t, p, q, y: f"P,{t},{p},1\nQ,{t},{q},1\nT,{t},{y},1"),
            ("one reading a row", "tag"),
        ),
        (lines("tag,time,value", lambda t, p, q, y: f"P,{t},{p}\nT,{t},{y}"), ("no reading of Q", "tag")),
        (
            lines("tag,time,value", lambda t, p, q, y: f"P,{t},{p}\nP,{t},{p + 1}\nQ,{t},{q}\nT,{t},{y}"),
            ("row 3", "second reading of P", "batch"),
        ),
        (lines("#1\ndouble tab(41,4)", lambda *r: " ".join(map(str, r))), ("row 2", "tab", "expected 164")),
        (lines("LabVIEW Measurement\nSeparator\tTab\ntime\tP", lambda *r: "1\t2"), ("End_of_Header",)),
        (lines("time_P,P,time_T,Q,T", lambda t, p, q, y: f"{t},{p},{t + 7},{q},{y}"), ("time_P", "time_T", "resample")),
        (lines("time,P,Q,T,T", lambda t, p, q, y: f"{t},{p},{q},{y},{y}"), ("T appears 2 times",)),
        (
            lines("time,P,Q,T", lambda t, p, q, y: f"{t - (t == 240.0) * 120.0},1000,0,{y}"),  # and no event
            ("row 4, column time: repeats",),
        ),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(text: str, words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(text)
    refusal(lambda: read_recording(tmp_path / "run.csv", layout=LAYOUT), *words)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
@pytest.mark.parametrize("as_index", [False, True])
def test_a_frame_with_dates_or_durations_is_in_seconds(unit: str, zone: str | None, as_index: bool) -> None:
    start = pandas.Timestamp("2026-10-24T23:50", tz="UTC")
    times = (start + pandas.to_timedelta(TIME, unit="s")).as_unit(unit)
    times = times.tz_localize(None) if zone is None else times.tz_convert(zone)
    for given, expected in ((times, TIME), (pandas.to_timedelta(TIME + 5.0, unit="s").as_unit(unit), TIME + 5.0)):
        frame = pandas.DataFrame({"time": given, "P": P, "T": T})
        found = Recording.from_frame(frame.set_index("time") if as_index else frame, inputs="P", outputs="T")
        assert found.time == pytest.approx(expected)


def test_arrays_of_dates_and_objects_are_in_seconds() -> None:
    times = np.datetime64("2026-07-24T18:00") + (TIME * 1e6).astype("timedelta64[us]")
    assert Recording("run", times, {"P": P}, {"T": T}).time == pytest.approx(TIME)
    frame = pandas.DataFrame({"time": list(pandas.DatetimeIndex(times).to_pydatetime()), "P": P, "T": T}, dtype=object)
    assert Recording.from_frame(frame, inputs="P", outputs="T").time == pytest.approx(TIME)
    with pytest.raises(InputError, match="column P"):
        Recording("run", TIME, {"P": times}, {"T": T})
    with pytest.raises(InputError, match="column T"):
        Recording.from_frame(frame.assign(T=pandas.to_datetime(frame["time"])), inputs="P", outputs="T")
