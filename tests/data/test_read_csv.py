"""Every complaint about a CSV file is one line that says where and what was expected."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from aero_recordings import read_aero
from facts import refusal

from aero_bayes.data import ColumnMap
from aero_bayes.data.read import column_names

pytestmark = pytest.mark.fast

GOOD = "time,V_m,i_m,omega_m,theta\n" + "".join(
    f"{k / 100:.2f},{10 if k > 5 else 0},{0.5 if k > 5 else 0},{20.0 * max(k - 5, 0)},{0.01 * k}\n" for k in range(20)
)


def write(folder: Path, text: str | bytes, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def with_cell(row: int, column: int, cell: str) -> str:
    """GOOD with one cell changed; ``row`` is the line of the file, the header being 1."""
    lines = GOOD.splitlines()
    cells = lines[row - 1].split(",")
    cells[column] = cell
    lines[row - 1] = ",".join(cells)
    return "\n".join(lines) + "\n"


def complaint(path: Path, *parts: str, **options: object) -> str:
    message = refusal(lambda: read_aero(path, **options), *parts)  # type: ignore[arg-type]
    assert str(path) in message or "column" in message
    return message


def test_reads_the_contract(tmp_path: Path) -> None:
    recording = read_aero(write(tmp_path, GOOD))
    assert recording.rows == 20
    assert recording.rate_hz == pytest.approx(100.0)
    assert list(recording.inputs) == ["V_m"]
    assert list(recording.outputs) == ["i_m", "omega_m", "theta"]
    assert recording.outputs["theta"][7] == 0.07
    assert recording.units == {"time": "s", "V_m": "V", "i_m": "A", "omega_m": "rad/s", "theta": "rad"}
    assert recording.name == "a"


@pytest.mark.parametrize(
    "variant",
    [
        GOOD.replace("\n", "\r\n"),
        "\ufeff" + GOOD,
        GOOD.rstrip("\n"),
        GOOD + "\n\n",
        GOOD.replace("0.05,", "\n0.05,"),
        GOOD.replace(",", ", "),
        GOOD.replace("time,V_m", '"time","V_m"'),
        "\n".join(line + ("," + ("note" if k == 0 else "some text")) for k, line in enumerate(GOOD.splitlines())),
        "\n".join(",".join(reversed(line.split(","))) for line in GOOD.splitlines()),
        "# rig 3, after lunch\n# " + GOOD,
        GOOD.replace("\n", "\r"),
        GOOD.replace("\n", ",\n", 1),
        GOOD.replace("\n", ",\n"),
    ],
    ids=[
        "crlf", "bom", "no last newline", "blank tail", "blank line", "spaces", "quotes", "text column", "order",
        "header as a comment", "carriage returns", "separator after the last name", "separator after the last cell",
    ],
)  # fmt: skip
def test_reads_variants_alike(tmp_path: Path, variant: str | bytes) -> None:
    plain, other = read_aero(write(tmp_path, GOOD)), read_aero(write(tmp_path, variant, "b.csv"))
    np.testing.assert_array_equal(plain.time, other.time)
    for name, values in plain.outputs.items():
        np.testing.assert_array_equal(values, other.outputs[name])


def test_a_line_of_units_is_part_of_the_names(tmp_path: Path) -> None:
    units = GOOD.replace("\n", "\ns,V,A,,deg\n", 1)
    path = write(tmp_path, units)
    assert column_names(path) == ["time [s]", "V_m [V]", "i_m [A]", "omega_m", "theta [deg]"]
    complaint(write(tmp_path, units.replace("deg", "V"), "b.csv"), "column theta", "V")
    for maps in ({}, {"time": ColumnMap("time [s]"), "theta": ColumnMap("theta [deg]", "deg")}):
        found = read_aero(path, maps)
        assert (found.rows, found.outputs["theta"][7]) == (20, pytest.approx(np.deg2rad(0.07)))


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["is empty"]),
        ("time,V_m,theta\n", ["holds no table"]),
        (GOOD.replace("V_m", "volts"), ["row 1", "no column V_m", "volts"]),
        (GOOD.replace("V_m", "v_m"), ["no column V_m", "did you mean v_m?"]),
        (GOOD.replace("time", "t"), ["no column time"]),
        ("time,V_m\n0,1\n1,1\n2,1\n3,1\n", ["no output column", "theta"]),
        (with_cell(9, 2, "abc"), ["row 9", "column i_m", "'abc' is not a number"]),
        (with_cell(9, 1, "1_000"), ["row 9", "column V_m", "not a number"]),
        (re.sub(r"(?m)^(0\.1\d),10", r"\1,", GOOD), ["row 12", "column V_m", "10 in a row"]),
        (re.sub(r"(?m),[\d.]+$", ",", GOOD), ["column theta", "0 readings in 20 rows"]),
        (with_cell(9, 4, "-Inf"), ["row 9", "column theta", "infinite"]),
        (with_cell(9, 1, ""), ["row 9", "column V_m", "missing"]),
        (with_cell(9, 0, "0.03"), ["row 9", "column time", "runs backwards", "0.03 after 0.06"]),
        (with_cell(9, 0, "0.06"), ["row 9", "column time", "repeats"]),
        (GOOD.replace("0.05,0,", "\n\n0.05,x,"), ["row 9", "column V_m"]),
        (GOOD.replace("0.10,10,0.5,100.0,0.1\n", "0.10,10,0,5,100.0,0.1\n"), ["row 12", "6 cells, expected 5"]),
        ("# rig 3\ntime,V_m,theta\n0,1,0\n1,x,0\n", ["row 4", "column V_m", "'x' is not a number"]),
        ("time,V_m,theta\n2026-13-01 10:00,1,0\n", ["row 2", "column time", "is no date"]),
        (GOOD.split("\n", 1)[1], ["row 1", "expected a header"]),
        (b"time,V_m,theta\n\x00\x01", ["not plain text"]),
        (GOOD.replace("time", "z\xe9it").encode("latin-1"), ["row 1", "no column time", "z\xe9it"]),
        ("time,V_m,theta\n0,1,0\n1,1,0\n", ["2 samples, expected at least 4"]),
        ("Dear all,\nthe test went well.\nBest, Jo\n", ["holds no table"]),
        ("time,V_m\n0,1,2\n1,1,2\n2,1,2\n", ["row 2: holds numbers, expected names above its 3 columns"]),
        ("time,V_m,i_m\n0,1,2\n1,off,off\n2,1,2\n3,1,2\n4,1,2\n", ["row 3, column V_m: 'off' is not a number"]),
    ],
)
def test_complaints(tmp_path: Path, text: str | bytes, parts: list[str]) -> None:
    complaint(write(tmp_path, text), *parts)


def test_units_wrong_by_a_thousand(tmp_path: Path) -> None:
    table = np.array([[float(cell) for cell in line.split(",")] for line in GOOD.splitlines()[1:]])
    cases = [
        (0, 1e3, ["column time", "ms"]),
        (1, 1e3, ["column V_m", "expected V", "mV"]),
        (2, 1e3, ["column i_m", "expected A", "mA"]),
        (3, 1e3, ["column omega_m", "rad/s"]),
        (4, 1e3, ["column theta", "expected rad", "degrees"]),
    ]
    for column, factor, parts in cases:
        scaled = table.copy()
        scaled[:, column] *= factor
        text = "time,V_m,i_m,omega_m,theta\n" + "\n".join(",".join(f"{x:.12g}" for x in row) for row in scaled)
        complaint(write(tmp_path, text), *parts)


def test_degrees_and_rpm_through_a_mapping(tmp_path: Path) -> None:
    text = "ms,volt,pitch,rpm,enc\n" + "\n".join(
        f"{10 * k},{5},{90 if k else 0},{60 * k},{512 * (k > 0)}" for k in range(8)
    )
    columns = {
        "time": ColumnMap("ms", unit="ms"),
        "V_m": ColumnMap("volt", scale=2.0, offset=1.0),
        "theta": ColumnMap("pitch", unit="deg"),
        "omega_m": ColumnMap("rpm", unit="rpm"),
    }
    recording = read_aero(write(tmp_path, text), columns)
    assert recording.time[3] == pytest.approx(0.03)
    assert recording.inputs["V_m"][0] == pytest.approx(12.0)
    assert recording.outputs["theta"][1] == pytest.approx(np.pi / 2)
    assert recording.outputs["omega_m"][2] == pytest.approx(4.0 * np.pi)
    columns["theta"] = ColumnMap("enc", unit="count", counts_per_revolution=2048)
    assert read_aero(write(tmp_path, text), columns).outputs["theta"][1] == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("column", "mapping", "part"),
    [
        ("theta", ColumnMap("theta", unit="furlong"), "unknown unit"),
        ("theta", ColumnMap("theta", unit="V"), "cannot become rad"),
        ("theta", ColumnMap("theta", unit="degC"), "cannot become rad"),
        ("theta", ColumnMap("theta", unit="count"), "counts_per_revolution"),
        ("theta", ColumnMap("pitch"), "no column pitch"),
        ("phi", ColumnMap("theta"), "phi is not a column of the model"),
    ],
)
def test_wrong_mappings(tmp_path: Path, column: str, mapping: ColumnMap, part: str) -> None:
    complaint(write(tmp_path, GOOD), "column", part, columns={column: mapping})


def test_missing_file_and_directory(tmp_path: Path) -> None:
    complaint(tmp_path / "none.csv", "no such file")
    complaint(tmp_path, "no file has a column of V_m")


def test_too_little_memory_names_the_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aero_bayes.data.tables.free_memory", lambda: 1000)
    complaint(write(tmp_path, GOOD), "20 rows of 5 columns", "MiB")


def test_memory_grows_with_the_table_only(tmp_path: Path) -> None:
    import tracemalloc

    rows = 200_000
    body = "".join(f"{k / 1000:.3f},1.5,{k % 7 / 1000}\n" for k in range(rows))
    path = write(tmp_path, "time,V_m,theta\n" + body)
    tracemalloc.start()
    recording = read_aero(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert recording.rows == rows
    # The table is 4.8 MB; one block of 8 MiB text passes through several forms.
    assert peak < 2 * 3 * 8 * rows + 12 * (8 << 20)
