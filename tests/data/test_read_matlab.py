"""MATLAB files of the layouts that Simulink and QUARC write, made by SciPy (version 5) and h5py (version 7.3)."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aero_recordings import read_aero
from facts import facts, refusal
from scipy.io import savemat

from aero_bayes.data import ColumnMap
from aero_bayes.errors import InputError

TIME = np.arange(50) / 100.0
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
    """As MATLAB does: arrays transposed, text as codes, structure arrays as references, 512 bytes of header first."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        references = file.create_group("#refs#")

        def array(parent: Any, name: str, value: Any) -> Any:
            if isinstance(value, str):
                codes = np.array([[ord(letter)] for letter in value] or [[0]], dtype=np.uint16)
                item = parent.create_dataset(name, data=codes)
                item.attrs["MATLAB_class"] = np.bytes_("char")
                if not value:
                    item.attrs["MATLAB_empty"] = np.uint8(1)
                return item
            item = parent.create_dataset(name, data=np.atleast_2d(np.asarray(value, dtype=float)).T)
            item.attrs["MATLAB_class"] = np.bytes_("double")
            return item

        def put(parent: Any, name: str, value: Any) -> None:
            if isinstance(value, dict):
                group = parent.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key, child in value.items():
                    put(group, key, child)
            elif isinstance(value, np.ndarray) and value.dtype == object:
                group = parent.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key in value[0]:
                    items = [array(references, f"{name}_{key}_{k}", one[key]).ref for k, one in enumerate(value)]
                    data = np.array(items, dtype=h5py.ref_dtype).reshape(1, -1)
                    group.create_dataset(key, data=data, dtype=h5py.ref_dtype)
            else:
                array(parent, name, value)

        for name, value in content.items():
            put(file, name, value)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(512))


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


def test_gaps_are_nan_and_inputs_must_be_whole(tmp_path: Path) -> None:
    gaps = DEGREES.copy()
    gaps[3:6] = np.nan
    savemat(tmp_path / "a.mat", {"log": np.vstack([TIME, VOLTS, gaps])})
    assert np.isnan(read_aero(tmp_path / "a.mat", LOG).outputs["theta"]).sum() == 3
    savemat(tmp_path / "b.mat", {"log": np.vstack([TIME, gaps, DEGREES])})
    with pytest.raises(InputError, match=facts("sample 4", "column V_m", "3")):
        read_aero(tmp_path / "b.mat", LOG)


def test_too_little_memory_names_the_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aero_bayes.data.matlab.free_memory", lambda: 100)
    savemat(tmp_path / "a.mat", {"log": np.vstack([TIME, VOLTS, DEGREES])})
    with pytest.raises(InputError, match="MiB of memory"):
        read_aero(tmp_path / "a.mat", LOG)


def test_the_content_decides_not_the_name(tmp_path: Path) -> None:
    savemat(tmp_path / "log.mat", {"log": np.vstack([TIME, VOLTS, DEGREES])})
    (tmp_path / "log.mat").rename(tmp_path / "log.csv")
    assert read_aero(tmp_path / "log.csv", LOG).rows == 50


@pytest.mark.parametrize("version", WRITERS)
def test_complaints(tmp_path: Path, version: str) -> None:
    for content, stated in (
        ({"log": np.vstack([TIME, VOLTS, DEGREES])}, ("column time", "log(1)", "log(2)", "log(3)")),
        ({"time": TIME, "V_m": VOLTS[:20], "theta": DEGREES}, ("column V_m", "20", "50")),
        ({"time": TIME, "V_m": VOLTS}, ("no output column",)),
        ({"note": "text"}, ("found nothing",)),
    ):
        WRITERS[version](tmp_path / "x.mat", content)
        with pytest.raises(InputError, match=facts(*stated)):
            read_aero(tmp_path / "x.mat")


@pytest.mark.parametrize("keep", [0.2, 0.6, 0.95])
@pytest.mark.parametrize("version", WRITERS)
def test_a_cut_file_is_one_line(tmp_path: Path, version: str, keep: float) -> None:
    path = tmp_path / "cut.mat"
    WRITERS[version](path, {"log": np.vstack([TIME, VOLTS, DEGREES])})
    raw = path.read_bytes()
    path.write_bytes(raw[: int(keep * len(raw))])
    refusal(lambda: read_aero(path, LOG), str(path))


@pytest.mark.parametrize(("at", "byte"), [(144, 5), (145, 14), (176, 14), (177, 255)])
def test_one_changed_byte_of_a_tag_is_one_line(tmp_path: Path, at: int, byte: int) -> None:
    """SciPy's reader crashes on these, so that it runs in a process of its own."""
    path = tmp_path / "damaged.mat"
    savemat(path, {"log": np.vstack([TIME, VOLTS, DEGREES])})
    raw = bytearray(path.read_bytes())
    raw[at] = byte
    path.write_bytes(raw)
    refusal(lambda: read_aero(path, LOG), str(path))


def test_without_h5py_the_message_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_hdf5(tmp_path / "new.mat", {"log": np.vstack([TIME, VOLTS, DEGREES])})
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(InputError, match=r"pip install h5py"):
        read_aero(tmp_path / "new.mat", LOG)


def test_objects_are_named(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "object.mat"
    with h5py.File(path, "w") as file:
        item = file.create_dataset("ts", data=np.zeros((6, 1), dtype=np.uint32))
        item.attrs["MATLAB_class"] = np.bytes_("timeseries")
        item.attrs["MATLAB_object_decode"] = np.int32(3)
    with pytest.raises(InputError, match=facts("ts", "timeseries")):
        read_aero(path, LOG)
