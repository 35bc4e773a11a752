"""One run in several files, and several runs in one: each is read as if it had a file of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from facts import refusal

from aero_bayes.data import ColumnMap, Layout, read_recording, read_recordings

pytestmark = pytest.mark.fast

LAYOUT = Layout.of(["u"], ["y"])
#: Times in microseconds since a logger was started: commands at 50 Hz, readings at 80 Hz.
COMMANDS, READINGS = 250_000_000 + 20_000 * np.arange(50), 250_013_000 + 12_500 * np.arange(70)


def write(path: Path, names: str, *columns: np.ndarray) -> Path:
    rows = [",".join(f"{x:.15g}" for x in row) for row in zip(*columns, strict=True)]
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join([names, *rows]) + "\n")
    return path


@pytest.fixture
def flight(tmp_path: Path) -> list[Path]:
    folder = tmp_path / "flight"
    write(folder / "battery.csv", "timestamp,voltage", COMMANDS, np.full(50, 12.0))
    return [
        write(folder / "commands.csv", "timestamp,u,v", COMMANDS, np.floor(np.arange(50) / 10), np.zeros(50)),
        write(folder / "rates.csv", "timestamp,y", READINGS, READINGS / 1e6),
    ]


@pytest.mark.parametrize("as_folder", [False, True])
def test_files_of_one_run_are_joined_on_time(flight: list[Path], as_folder: bool) -> None:
    columns = {"time": ColumnMap("timestamp", unit="us")}
    paths = [flight[0].parent] if as_folder else flight
    (found,) = read_recordings(paths, columns, layout=LAYOUT)
    assert found.name == ("flight" if as_folder else "commands+rates")
    assert found.time == pytest.approx(np.union1d(COMMANDS, READINGS) / 1e6)
    read = np.isfinite(found.outputs["y"])
    assert found.time[read] == pytest.approx(READINGS / 1e6)
    assert found.outputs["y"][read] == pytest.approx(READINGS / 1e6)
    held = np.searchsorted(COMMANDS / 1e6, found.time + 1e-9) - 1
    assert found.inputs["u"].tolist() == np.floor(held / 10).tolist()
    assert all(name in found.notes[0] for name in ("commands.csv", "rates.csv"))
    assert read_recording(paths[0] if as_folder else paths, columns, layout=LAYOUT).sha256 == found.sha256


def test_dates_of_several_files_have_one_origin(tmp_path: Path) -> None:
    start = np.datetime64("2026-03-01T23:59:50")
    for name, first, count in (("u", 0, 30), ("y", 7, 20)):
        rows = [f"{start + np.timedelta64(first + k, 's')},{first + k}" for k in range(count)]
        (tmp_path / f"{name}.csv").write_text("\n".join([f"time,{name}", *rows]))
    (found,) = read_recordings([tmp_path / "u.csv", tmp_path / "y.csv"], layout=LAYOUT)
    read = np.isfinite(found.outputs["y"])
    assert found.time == pytest.approx(np.arange(30.0))
    assert found.outputs["y"][read] == pytest.approx(found.time[read])
    assert found.inputs["u"] == pytest.approx(found.time)


def test_files_that_cannot_be_joined_are_refused(flight: list[Path]) -> None:
    columns = {"time": ColumnMap("timestamp", unit="us")}
    other = write(flight[0].parent / "rates2.csv", "timestamp,y", READINGS, READINGS / 1e6)
    stated = ("commands.csv: has u but not y", "folder")  # they belong together in more than one way
    refusal(lambda: read_recordings([*flight, other], columns, layout=LAYOUT), *stated)
    write(flight[1], "timestamp,y", READINGS - 250_000_000, READINGS / 1e6)
    refusal(lambda: read_recordings(flight, columns, layout=LAYOUT), "do not overlap")


def test_a_table_with_a_row_for_each_clock(tmp_path: Path) -> None:
    rows = sorted([(0.3 * k, f"{k % 3},") for k in range(20)] + [(0.05 + 0.2 * k, f",{k}") for k in range(30)])
    (tmp_path / "run.csv").write_text("\n".join(["time,u,y", *(f"{t:.6f},{cells}" for t, cells in rows)]))
    found = read_recording(tmp_path / "run.csv", layout=LAYOUT)
    read = np.isfinite(found.outputs["y"])
    assert found.outputs["y"][read] == pytest.approx((found.time[read] - 0.05) / 0.2)
    assert found.inputs["u"].tolist() == [int(t / 0.3 + 1e-6) % 3 for t in found.time]


LENGTHS = [6, 30, 12, *[5] * 12]


def stacked(path: Path, names: str, label: bool) -> Path:
    lines = [names]
    for batch, rows in enumerate(LENGTHS):
        lines += [",".join([*([f"{batch + 10}"] if label else []), f"{0.5 * k}", f"{batch}", f"{100 * batch + k}"])
                  for k in range(rows)]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("label", [False, True])
def test_batches_of_a_table_are_recordings(tmp_path: Path, label: bool) -> None:
    path = stacked(tmp_path / "runs.csv", "batch,time,u,y" if label else "time,u,y", label)
    found = read_recordings([path], layout=LAYOUT, batch="batch" if label else None)
    assert [r.name for r in found] == [f"runs {k + (10 if label else 1)}" for k in range(len(LENGTHS))]
    assert [r.rows for r in found] == LENGTHS
    for batch, recording in enumerate(found):
        assert recording.time[0] == 0.0
        assert (recording.inputs["u"] == batch).all()
        assert recording.outputs["y"].tolist() == [100 * batch + k for k in range(recording.rows)]
        assert recording.findings == ()
    assert found[1].first_row == 8


def test_batches_of_a_table_with_one_reading_a_row(tmp_path: Path) -> None:
    rows = [f"{run},{t},{signal},{value}" for run, size in (("wet", 5), ("dry", 9)) for t in range(size)
            for signal, value in (("u", len(run)), ("y", 10 * size + t))]  # fmt: skip
    (tmp_path / "lab.csv").write_text("\n".join(["batch,time,tag,value", *rows]))
    wet, dry = read_recordings([tmp_path / "lab.csv"], layout=LAYOUT, batch="batch")
    assert (wet.name, dry.name) == ("lab wet", "lab dry")
    assert wet.outputs["y"].tolist() == [50, 51, 52, 53, 54]
    assert dry.outputs["y"].tolist() == [*range(90, 99)]


def test_a_batch_whose_rows_are_wrong_is_named_by_the_row_of_the_file(tmp_path: Path) -> None:
    path = stacked(tmp_path / "runs.csv", "batch,time,u,y", True)
    path.write_text(path.read_text().replace("11,1.0,1,102", "11,1.0,,102"))
    for batch, stated in (("batch", "row 10, column u: missing"), ("lot", "no column lot")):
        refusal(lambda batch=batch: read_recordings([path], layout=LAYOUT, batch=batch), stated)


def test_batches_of_a_few_rows_are_left_out_and_told(tmp_path: Path) -> None:
    time = np.array([0, 1, 2, 3, 4, 0, 1, 0, 0.5, 1, 1.5, 2])
    write(tmp_path / "runs.csv", "time,u,y", time, time, time)
    first, third = read_recordings([tmp_path / "runs.csv"], layout=LAYOUT)
    assert (first.name, third.name, third.rows) == ("runs 1", "runs 3", 5)
    assert any("2 with fewer than 4 rows" in note for note in third.notes)


def test_one_wrong_time_or_a_clock_that_was_set_back_is_no_batch(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(0.0, 60.0), np.arange(30.0, 90.0)])
    (found,) = read_recordings([write(tmp_path / "run.csv", "time,u,y", time, time, time)], layout=LAYOUT)
    assert [f.kind for f in found.findings] == ["clock"]
    time = np.where(np.arange(60) == 30, 0.0, np.arange(60))
    wrong = write(tmp_path / "run.csv", "time,u,y", time, time, time)
    refusal(lambda: read_recordings([wrong], layout=LAYOUT), "row 32, column time: runs backwards")
