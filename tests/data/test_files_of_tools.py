"""Files of other tools, each made by a library of that tool or by the layout that it publishes, are read right."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pytest
from facts import refusal
from scipy.io import savemat

from aero_bayes import read_recording
from aero_bayes.data import ColumnMap, Layout
from aero_bayes.data.read import column_names

pytestmark = pytest.mark.fast

LAYOUT = Layout.of(["P", "Q"], ["T"], {"P": "W", "Q": "W", "T": "K"})
TIME = 0.5 * np.arange(40)
P, Q = 1000.0 + 500.0 * (np.arange(40) % 3), -0.25 * np.arange(40)
T = 290.0 + 0.125 * np.arange(40)


def mdf(path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    signals = [asammdf.Signal(v / 1e3, TIME, name=n, unit="kW") for n, v in (("P", P), ("Q", Q))]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals)
        file.append([asammdf.Signal(T[::2], TIME[::2], name="T", unit="K")])
        file.save(path)


def tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    every = {"wf_increment": 0.5, "wf_start_offset": 0.0, "wf_samples": 40}
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
        "X0\t0,0\t0,0\t0,0\t\t", "Delta_X\t0,5\t0,5\t0,5\t\t", "***End_of_Header***\t\t\t\t\t",
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


def excel_of_clock_times(path: Path) -> None:
    pytest.importorskip("openpyxl")
    start = datetime.datetime(2026, 7, 24, 23, 59, 50)
    times = [(start + datetime.timedelta(seconds=t)).time() for t in TIME]
    pandas.DataFrame({"time": times, "P": P, "Q": Q, "T": T}).to_excel(path, index=False)


def parquet(path: Path) -> None:
    pytest.importorskip("pyarrow")
    pandas.DataFrame({"time": pandas.to_timedelta(TIME, unit="s"), "P": P, "Q": Q, "T": T}).to_parquet(path)


def parquet_in_rows(path: Path) -> None:
    pytest.importorskip("pyarrow")
    frame = pandas.DataFrame({"time": TIME, "P": P, "Q": Q, "T": T})
    frame.melt(id_vars="time", var_name="tag").to_parquet(path)


def result(path: Path, order: str, time: str = "time") -> None:
    """A result of Dymola (``binTrans``) or OpenModelica: an event at 5 s, one with the other sign, a parameter."""
    at = np.insert(np.arange(40), 10, 10)
    values = np.column_stack([TIME[at], P[at], Q[at], T[at]])
    values[10, 1] += 300.0  # before the event
    names = [time, "rig.P", "rig.Q", "rig.T", "minus", "R"]
    info = np.array([[0, 1, 0, -1], [2, 2, 0, -1], [2, 3, 0, -1], [2, 4, 0, -1], [2, -4, 0, -1], [1, 2, 0, 0]])
    text = np.array([n.ljust(8) for n in names])
    constants = np.array([[0.0, 5.0], [20.0, 5.0]])
    if order == "binTrans":
        letters = np.array(["".join(n[k] for n in text) for k in range(8)])
        content = {"name": letters, "dataInfo": info.T, "data_1": constants.T, "data_2": values.T}
    else:
        content = {"name": text, "dataInfo": info, "data_1": constants, "data_2": values}
    about = np.array(["Atrajectory", "1.1".ljust(11), " " * 11, order.ljust(11)])
    savemat(path, {"Aclass": about, **content}, format="4")


def dymola(path: Path) -> None:
    result(path, "binTrans")


def normal(path: Path) -> None:
    result(path, "binNormal", "Time")


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
    "excel of clock times": (".xlsx", excel_of_clock_times, {}),
    "parquet": (".parquet", parquet, {}),
    "parquet in rows": (".parquet", parquet_in_rows, {}),
    "dymola": (".mat", dymola, {}),
    "binNormal": (".mat", normal, {}),
    "to workspace": (".mat", to_workspace, {"P": "P.signals(1)", "Q": "Q.signals(1)", "T": "T.signals(1)"}),
    "timetable": (".mat", timetable, {}),
}


@pytest.mark.filterwarnings("ignore")  # of the libraries that write the files
@pytest.mark.parametrize("form", FILES)
def test_a_file_is_read_right(form: str, tmp_path: Path) -> None:
    suffix, write, sources = FILES[form]
    path = tmp_path / f"run{suffix}"
    write(path)
    found = read_recording(path, {name: ColumnMap(source) for name, source in sources.items()}, layout=LAYOUT)
    assert found.time - found.time[0] == pytest.approx(TIME, abs=1e-6)
    assert found.inputs["P"] == pytest.approx(P)
    assert found.inputs["Q"] == pytest.approx(Q)
    seen = np.isfinite(found.outputs["T"])
    assert seen.sum() in (20, 40)
    assert found.outputs["T"][seen] == pytest.approx(T[seen])
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
@pytest.mark.parametrize("suffix", [".mf4", ".tdms", ".mat"])
def test_a_damaged_file_is_one_line(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    start = {".mf4": b"MDF     4.10    ", ".tdms": b"TDSm\x0e", ".mat": b"\0\0\0\0"}[suffix]
    path.write_bytes(start + bytes(range(200)))
    refusal(lambda: read_recording(path, layout=LAYOUT))


@pytest.mark.parametrize(
    ("header", "row", "last"),
    [
        (
            "Timestamp,F,F Quality,y,y Quality\n",
            "31-Dec-25 23:59:{second},1.5,Good,2.5,Good\n",
            "01-Jan-26 00:00:10,1.5,Good,Bad Input,Bad\n",
        ),
        (
            "\ufeffTimestamp;F [N];y\r\n",
            "28.02.2026 23:59:{second};1,5;2,5\r\n",
            "01.03.2026 00:00:10;1,5;2,5\r\n",
        ),
    ],
    ids=["historian with quality", "German spreadsheet"],
)
def test_dates_of_historians_and_german_spreadsheets(header: str, row: str, last: str, tmp_path: Path) -> None:
    rows = [row.format(second=second) for second in (20, 30, 40, 50)]
    (tmp_path / "run.csv").write_text("".join([header, *rows, last]), encoding="utf-8")
    columns = {"time": ColumnMap("Timestamp")}
    found = read_recording(tmp_path / "run.csv", columns, layout=Layout.of(["F"], ["y"]))
    np.testing.assert_array_equal(np.diff(found.time), [10.0, 10.0, 10.0, 20.0])
    np.testing.assert_array_equal(found.inputs["F"], np.full(5, 1.5))
    np.testing.assert_array_equal(found.outputs["y"], [2.5, 2.5, 2.5, 2.5, np.nan if "Bad" in last else 2.5])


@pytest.mark.parametrize(
    ("head", "row", "names"),
    [
        (
            "format,ControlDesk measurement,1.0\ndescription,run 3\n\npath,,F,y\nunit,s,N,m\n",
            ",{0},{1},{2}\n", ["path [unit]", "s", "F [N]", "y [m]"],
        ),
        (
            "Record Length,60,,\nSample Interval,0.1,,\nSource,F,y,\nSecond,N,m,\n",
            "{0},{1},{2},\n", ["Source [s]", "F [N]", "y [m]"],
        ),
    ],
    ids=["dSPACE", "oscilloscope"],
)  # fmt: skip
def test_what_stands_above_the_names_is_left_out(head: str, row: str, names: list[str], tmp_path: Path) -> None:
    rows = "".join(row.format(0.1 * k, 1.5, float(k)) for k in range(6))
    (tmp_path / "run.csv").write_text(head + rows, encoding="utf-8")
    assert column_names(tmp_path / "run.csv") == names
    time = next(n for n in names if n not in ("F [N]", "y [m]") and n != "path [unit]")
    columns = {"time": ColumnMap(time, unit="s")}
    found = read_recording(tmp_path / "run.csv", columns, layout=Layout.of(["F"], ["y"], {"F": "N", "y": "m"}))
    assert found.time == pytest.approx(0.1 * np.arange(6))
    assert found.outputs["y"].tolist() == list(range(6))
    assert "row" in found.notes[0]


@pytest.mark.long
def test_an_object_of_matlab_that_is_no_table_is_refused_in_one_line(tmp_path: Path) -> None:
    """A Simulink Dataset is such an object; mat-io writes others, dates here, as MATLAB does."""
    matio = pytest.importorskip("matio")
    matio.save_to_mat(tmp_path / "run.mat", {"dates": np.array(["2026-01-01", "2026-01-02"], dtype="datetime64[ms]")})
    path = tmp_path / "run.mat"
    for ask in (lambda: column_names(path), lambda: read_recording(path, layout=LAYOUT)):
        refusal(ask, "run.mat: ", "Simulink Dataset save the elements")
