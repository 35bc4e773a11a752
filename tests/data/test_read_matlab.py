"""MATLAB files of the layouts that Simulink and QUARC write, made by SciPy (version 5) and mat-io (version 7.3)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aero_recordings import read_aero
from facts import facts, refusal
from scipy.io import savemat

from aero_bayes.data import ColumnMap
from aero_bayes.errors import InputError

N = np.arange(50)
TIME = N / 100.0
VOLTS = np.where(TIME > 0.1, 10.0, 0.0)
DEGREES = 30.0 * TIME
SPEED = 100.0 * TIME

LOG = {"time": ColumnMap("log(1)"), "V_m": ColumnMap("log(2)"), "theta": ColumnMap("log(3)", unit="deg")}


def structure_with_time() -> dict[str, Any]:
    signals = [
        {"values": VOLTS[:, None], "dimensions": 1.0, "label": "V_m"},
        {"values": np.column_stack([DEGREES, SPEED]), "dimensions": 2.0, "label": ""},
    ]
    return {"run": {"time": TIME[:, None], "signals": np.array(signals, dtype=object), "blockName": "model/Scope"}}


CASES: dict[str, tuple[dict[str, Any], dict[str, ColumnMap]]] = {
    "to file: a row each": ({"log": np.vstack([TIME, VOLTS, DEGREES])}, LOG),
    "to workspace: a column each": ({"log": np.column_stack([TIME, VOLTS, DEGREES])}, LOG),
    "vectors": (
        {"time": TIME[:, None], "V_m": VOLTS[None, :], "pitch": DEGREES, "note": "text", "gain": 3.0},
        {"theta": ColumnMap("pitch", unit="deg")},
    ),
    "tout": ({"tout": TIME[:, None], "V_m": VOLTS, "theta": np.deg2rad(DEGREES)}, {}),
    "structure": (
        {"data": {"t": TIME, "u": VOLTS, "y": DEGREES}},
        {"time": ColumnMap("data.t"), "V_m": ColumnMap("data.u"), "theta": ColumnMap("data.y", unit="deg")},
    ),
    "structure with time": (structure_with_time(), {"theta": ColumnMap("run.signals(2)(1)", unit="deg")}),
}


def write_hdf5(path: Path, content: dict[str, Any]) -> None:
    """As MATLAB does: arrays transposed, text as codes, structure arrays as references."""
    pytest.importorskip("matio").save_to_mat(str(path), content, version="v7.3")


WRITERS = {"5": savemat, "7.3": write_hdf5}


@pytest.mark.parametrize("version", WRITERS)
@pytest.mark.parametrize("case", CASES)
def test_layouts(tmp_path: Path, case: str, version: str) -> None:
    content, columns = CASES[case]
    WRITERS[version](tmp_path / "log.mat", content)
    recording = read_aero(tmp_path / "log.mat", columns)
    np.testing.assert_array_equal(recording.time, TIME)
    np.testing.assert_array_equal(recording.inputs["V_m"], VOLTS)
    np.testing.assert_allclose(recording.outputs["theta"], np.deg2rad(DEGREES), rtol=1e-15)


def test_too_little_memory_names_the_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aero_bayes.data.matlab.free_memory", lambda: 100)
    savemat(tmp_path / "a.csv", {"log": np.vstack([TIME, VOLTS, DEGREES])})  # the content decides, not the name
    refusal(lambda: read_aero(tmp_path / "a.csv", LOG), "MiB of memory")


@pytest.mark.parametrize("version", WRITERS)
def test_complaints(tmp_path: Path, version: str) -> None:
    for content, stated in (
        ({"log": np.vstack([TIME, VOLTS, DEGREES])}, ("column time", "log(1)", "log(2)", "log(3)")),
        ({"time": TIME, "V_m": VOLTS[:20], "theta": DEGREES}, ("column V_m", "20", "50")),
        ({"time": TIME, "V_m": VOLTS}, ("no output column",)),
        (
            {"time": TIME, "V_m": np.where((N >= 3) & (N < 6), np.nan, VOLTS), "theta": DEGREES},
            ("sample 4", "column V_m", "3"),
        ),
        ({"note": "text"}, ("found nothing",)),
    ):
        WRITERS[version](tmp_path / "x.mat", content)
        with pytest.raises(InputError, match=facts(*stated)):
            read_aero(tmp_path / "x.mat")


@pytest.mark.parametrize(("version", "keep", "change"), [
    *((version, keep, {}) for version in WRITERS for keep in (0.2, 0.6, 0.95)),
    # SciPy's reader crashes on one changed byte of a tag, so that it runs in a process of its own
    *(("5", 1.0, {at: byte}) for at, byte in ((144, 5), (145, 14), (176, 14), (177, 255))),
])  # fmt: skip
def test_a_damaged_file_is_one_line(tmp_path: Path, version: str, keep: float, change: dict[int, int]) -> None:
    path = tmp_path / "damaged.mat"
    WRITERS[version](path, {"log": np.vstack([TIME, VOLTS, DEGREES])})
    raw = bytearray(path.read_bytes())
    for at, byte in change.items():
        raw[at] = byte
    path.write_bytes(raw[: int(keep * len(raw))])
    refusal(lambda: read_aero(path, LOG), str(path))


def test_objects_are_named(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "object.mat"
    with h5py.File(path, "w") as file:
        item = file.create_dataset("ts", data=np.zeros((6, 1), dtype=np.uint32))
        item.attrs["MATLAB_class"] = np.bytes_("timeseries")
        item.attrs["MATLAB_object_decode"] = np.int32(3)
    with pytest.raises(InputError, match=facts("ts", "timeseries")):
        read_aero(path, LOG)
