"""Files in every form are read as what they say: those of tools, made by a library of the tool or by the layout that it
publishes, dialects of text, data frames of any time; or they are refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pytest
from facts import refusal
from scipy.io import savemat

from aero_bayes import InputError, Recording, read_recording
from aero_bayes.data import ColumnMap, Layout
from aero_bayes.data.read import column_names

pytestmark = pytest.mark.fast

LAYOUT = Layout.of(["P", "Q"], ["T"], {"P": "W", "Q": "W", "T": "K"})
TIME = 120.0 * np.arange(40)
P, Q = 1000.0 + 500.0 * (np.arange(40) % 3), -0.25 * np.arange(40)
T = 290.0 + 0.125 * np.arange(40)
ROWS = list(zip(TIME, P, Q, T, strict=True))


def mdf(path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    signals = [asammdf.Signal(v / 1e3, TIME, name=n, unit="kW") for n, v in (("P", P), ("Q", Q))]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals)
        file.append([asammdf.Signal(T[::2], TIME[::2], name="T", unit="K")])
        file.save(path)


def tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    every = {"wf_increment": 120.0, "wf_start_offset": 0.0, "wf_samples": 40}
    with nptdms.TdmsWriter(path) as file:
        units = {"P": "W", "Q": "W", "T": "degC"}
        values = {"P": P, "Q": Q, "T": T - 273.15}
        file.write_segment(
            [nptdms.ChannelObject("rig", n, values[n], every | {"unit_string": u}) for n, u in units.items()]
        )


def lvm(path: Path) -> None:
    head = [
        "LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t,",
        "Multi_Headings\tNo", "X_Columns\tNo", "Time_Pref\tRelative", "***End_of_Header***\t", "\t",
        "Channels\t3\t\t\t\t", "Samples\t40\t40\t40\t\t", "Y_Unit_Label\tkW\tW\tK", "X_Dimension\tTime\tTime\tTime",
        "X0\t0,0\t0,0\t0,0\t\t", "Delta_X\t120,0\t120,0\t120,0\t\t", "***End_of_Header***\t\t\t\t\t",
        "X_Value\tP\tQ\tT\tComment",
    ]  # fmt: skip
    rows = [f"\t{p / 1000}\t{q}\t{y}".replace(".", ",") for p, q, y in zip(P, Q, T, strict=True)]
    path.write_text("\n".join(head + rows) + "\n")


def excel(path: Path) -> None:
    pytest.importorskip("openpyxl")
    rows = [["Test bench 3", None, None, None, None], [None] * 5, ["time", "P", "Q", "T", "T status"],
            ["s", "kW", "W", "degC", None]]  # fmt: skip
    rows += [[t, p / 1e3, q, y - 273.15, "Good"] for t, p, q, y in zip(TIME, P, Q, T, strict=True)]
    rows += [[None] * 5, ["Mean", 1.5, -5.0, 20.0, None]]
    pandas.DataFrame(rows).to_excel(path, header=False, index=False)


def parquet(path: Path) -> None:
    pytest.importorskip("pyarrow")
    pandas.DataFrame({"time": pandas.to_timedelta(TIME, unit="s"), "P": P, "Q": Q, "T": T}).to_parquet(path)


def result(path: Path, order: str, time: str) -> None:
    """A result of Dymola (``binTrans``) or OpenModelica: an event at 1200 s, one with the other sign, a parameter."""
    at = np.insert(np.arange(40), 10, 10)
    values = np.column_stack([TIME[at], P[at], Q[at], T[at]])
    values[10, 1] += 300.0  # before the event
    names = [time, "rig.P", "rig.Q", "rig.T", "minus", "R"]
    info = np.array([[0, 1, 0, -1], [2, 2, 0, -1], [2, 3, 0, -1], [2, 4, 0, -1], [2, -4, 0, -1], [1, 2, 0, 0]])
    text = np.array([n.ljust(8) for n in names])
    constants = np.array([[0.0, 5.0], [4680.0, 5.0]])
    if order == "binTrans":
        letters = np.array(["".join(n[k] for n in text) for k in range(8)])
        content = {"name": letters, "dataInfo": info.T, "data_1": constants.T, "data_2": values.T}
    else:
        content = {"name": text, "dataInfo": info, "data_1": constants, "data_2": values}
    about = np.array(["Atrajectory", "1.1".ljust(11), " " * 11, order.ljust(11)])
    savemat(path, {"Aclass": about, **content}, format="4")


def to_workspace(path: Path) -> None:
    """A structure with time for each block, as Simulink writes them, one of them at half the rate."""

    def block(values: np.ndarray, every: int = 1) -> dict[str, object]:
        return {"time": TIME[::every, None], "signals": {"values": values[::every, None], "label": ""}}

    savemat(path, {"P": block(P), "Q": block(Q), "T": block(T, 2)})


def timetable(path: Path) -> None:
    matio = pytest.importorskip("matio")
    index = pandas.Index(pandas.to_timedelta(TIME * 1e3, unit="ms").as_unit("ms"), name="Time")
    matio.save_to_mat(str(path), {"log": pandas.DataFrame({"P": P, "Q": Q, "T": T}, index=index)}, version="v7")


FILES: dict[str, tuple[str, Callable[[Path], None], dict[str, str]]] = {
    "mdf": (".mf4", mdf, {}),
    "tdms": (".tdms", tdms, {}),
    "lvm": (".lvm", lvm, {}),
    "excel": (".xlsx", excel, {}),
    "parquet": (".parquet", parquet, {}),
    "dymola": (".mat", lambda path: result(path, "binTrans", "time"), {}),
    "binNormal": (".mat", lambda path: result(path, "binNormal", "Time"), {}),
    "to workspace": (".mat", to_workspace, {"P": "P.signals(1)", "Q": "Q.signals(1)", "T": "T.signals(1)"}),
    "timetable": (".mat", timetable, {}),
}


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


FORMS: dict[str, str] = {
    "sep.csv": lines("sep=;\ntime;P;Q;T", lambda *r: ";".join(f"{x:.3f}".replace(".", ",") for x in r)),
    "spaces.csv": lines("  time    P   Q     T", lambda *r: "  ".join(f"{x:12.4f}" for x in r)),
    "fortran.txt": lines("time P Q T", lambda *r: " ".join(f"{x:.8e}".replace("e", "D") for x in r)),
    "clock.csv": lines("time,P,Q,T", lambda t, *r: f"{clock(t)},{','.join(map(str, r))}"),
    "thousands.csv": lines("time,P,Q,T", lambda t, p, q, y: f'"{t:,.1f}","{p:,.1f}",{q},{y}'),
    "tausend.csv": lines("time;P;Q;T", lambda *r: ";".join(map(german, r))),
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
    "historian.csv": lines(
        "Timestamp,P,P Quality,Q,T,T Quality",
        lambda t, p, q, y: f"{late(t, '%d-%b-%y %H:%M:%S')},{p},Good,{q},{y},Good",
    )
    + "04-Mar-26 00:00:00,1000,Good,0,Bad Input,Bad\n",
    "spreadsheet.csv": lines(
        "\ufeffTimestamp;P [W];Q;T",
        lambda t, *r: f"{late(t, '%d.%m.%Y %H:%M:%S')};{';'.join(map(str, r))}".replace(".", ",").replace(",", ".", 2),
    ),
    "dspace.csv": lines(
        "format,ControlDesk measurement,1.0\ndescription,run 3\n\npath,,P,Q,T\nunit,s,W,W,K",
        lambda *r: "," + ",".join(map(str, r)),
    ),
    "scope.csv": lines(
        "Record Length,60,,,\nSample Interval,0.1,,,\nSource,P,Q,T,\nSecond,W,W,K,",
        lambda *r: ",".join(map(str, r)) + ",",
    ),
    "zones.csv": lines("time,P,Q,T", lambda t, *r: f"{summer_time(t)},{','.join(map(str, r))}"),
}


#: What signals are called where it is not their own name.
SOURCES = {
    "table.txt": {"P": "tab(2)", "Q": "tab(3)", "T": "tab(4)"},
    "historian.csv": {"time": "Timestamp"},
    "spreadsheet.csv": {"time": "Timestamp"},
    "dspace.csv": {"time": "s"},
    "scope.csv": {"time": "Source [s]"},
}


@pytest.mark.filterwarnings("ignore")  # of the libraries that write the files
@pytest.mark.parametrize("form", [*FILES, *FORMS])
def test_a_form_is_read_right(form: str, tmp_path: Path) -> None:
    written = Path(form).suffix, lambda path: path.write_text(FORMS[form], encoding="utf-8"), SOURCES.get(form, {})
    suffix, write, sources = FILES.get(form, written)
    path = tmp_path / f"run{suffix}"
    write(path)
    found = read_recording(path, {name: ColumnMap(source) for name, source in sources.items()}, layout=LAYOUT)
    assert found.time[:40] - found.time[0] == pytest.approx(TIME, abs=1e-3)
    assert found.inputs["P"][:40] == pytest.approx(P)
    assert found.inputs["Q"][:40] == pytest.approx(Q)
    seen = np.isfinite(found.outputs["T"])
    assert seen.sum() in (20, 40)
    assert found.outputs["T"][seen] == pytest.approx(T[seen[:40]])
    assert [finding.kind for finding in found.findings] == ["quality"] * (form == "historian.csv")
    names = column_names(path)
    for name in ("P", "Q", "T"):
        assert any(sources.get(name, name) in (n, n.partition(" [")[0], n.rpartition(".")[2]) for n in names)


@pytest.mark.parametrize(("suffix", "start", "extra", "module"), [
    (".mf4", b"MDF     4.10    ", "mdf", "asammdf"), (".tdms", b"TDSm", "tdms", "nptdms"),
    (".xlsx", b"PK", "excel", "openpyxl"), (".parquet", b"PAR1", "parquet", "pyarrow"),
])  # fmt: skip
def test_a_reader_that_is_missing_is_named(
    suffix: str, start: bytes, extra: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, module, None)
    path = tmp_path / f"run{suffix}"
    path.write_bytes(start + bytes(600))
    for ask in (lambda: read_recording(path, layout=LAYOUT), lambda: column_names(path)):
        refusal(ask, f"pip install 'aero-bayes[{extra}]'")


@pytest.mark.filterwarnings("ignore")  # asammdf, which closes what it did not open
@pytest.mark.parametrize("suffix", [".mf4", ".tdms"])
def test_a_damaged_file_is_one_line(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    start = {".mf4": b"MDF     4.10    ", ".tdms": b"TDSm\x0e"}[suffix]
    path.write_bytes(start + bytes(range(200)))
    refusal(lambda: read_recording(path, layout=LAYOUT))


def test_a_unit_of_time_that_was_given_holds(tmp_path: Path) -> None:
    (tmp_path / "epoch.csv").write_text(FORMS["epoch.csv"])
    found = read_recording(tmp_path / "epoch.csv", {"time": ColumnMap("time", unit="ms")}, layout=LAYOUT)
    assert np.diff(found.time) == pytest.approx(np.diff(TIME))


def test_seconds_far_from_zero_stay_seconds(tmp_path: Path) -> None:
    for start, step in ((40000.0, 0.01), (46319.75, 0.002), (1.7e9, 120.0), (50000.0, 0.5), (43000.0, 1.0 / 256.0)):
        rows = [f"{start + step * k!r},1,1,{y}" for k, y in enumerate(T)]
        (tmp_path / "run.csv").write_text("\n".join(["time,P,Q,T", *rows]))
        assert np.diff(read_recording(tmp_path / "run.csv", layout=LAYOUT).time) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize(("column", "reading"), [("T_quality", "0.0"), ("Quality", "0.0"), ("T status", "No Data")])
def test_readings_that_are_marked_as_bad_are_not_fitted(column: str, reading: str, tmp_path: Path) -> None:
    rows = [f"{t},{p},{q},{reading if k in (3, 9) else y},{'Bad' if k in (3, 9) else 'Good'}"
            for k, (t, p, q, y) in enumerate(ROWS)]  # fmt: skip
    (tmp_path / "run.csv").write_text("\n".join([f"time,P,Q,T,{column}", *rows]))
    found = read_recording(tmp_path / "run.csv", layout=LAYOUT)
    assert np.flatnonzero(np.isnan(found.outputs["T"])).tolist() == [3, 9]
    assert [f.kind for f in found.findings] == ["quality"]
    assert "rows 5, 11" in found.findings[0].where


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
            ("row 3", "second reading of P", "several runs"),
        ),
        (lines("#1\ndouble tab(41,4)", lambda *r: " ".join(map(str, r))), ("row 2", "tab", "expected 164")),
        (lines("time_P,P,time_T,Q,T", lambda t, p, q, y: f"{t},{p},{t + 7},{q},{y}"), ("time_P", "time_T", "resample")),
        (lines("time,P,Q,T,T", lambda t, p, q, y: f"{t},{p},{q},{y},{y}"), ("T appears 2 times",)),
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


def test_dates_are_times_and_no_readings() -> None:
    times = np.datetime64("2026-07-24T18:00") + (TIME * 1e6).astype("timedelta64[us]")
    assert Recording("run", times, {"P": P}, {"T": T}).time == pytest.approx(TIME)
    frame = pandas.DataFrame({"time": list(pandas.DatetimeIndex(times).to_pydatetime()), "P": P, "T": T}, dtype=object)
    assert Recording.from_frame(frame, inputs="P", outputs="T").time == pytest.approx(TIME)
    with pytest.raises(InputError, match="column P"):
        Recording("run", TIME, {"P": times}, {"T": T})
