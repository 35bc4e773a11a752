"""Situations from public bug reports whose equations are right: right values, the cause named, the model not blamed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas
import pytest
from click.testing import CliRunner

import aero_bayes
from aero_bayes.cli import main
from aero_bayes.data import ColumnMap, Layout
from aero_bayes.errors import InputError

CASES_AT = Path(os.environ.get("AERO_BAYES_CASES", Path(__file__).parents[2].parent / "shared" / "cases"))
pytestmark = [pytest.mark.skipif(not CASES_AT.is_dir(), reason=f"no cases at {CASES_AT}"), pytest.mark.fast]


def fitted(folder: str, config: str, data: list[str], out: Path, text: str = "") -> dict[str, Any]:
    """The result of ``fit`` to one or more files; ``text`` is put in place of the empty table of columns."""
    given = (CASES_AT / folder / config).read_text()
    given = given.replace("[data.columns]", f"[data.columns]\n{text}", 1)
    for line in [line for line in given.splitlines() if line.startswith("sources")]:
        name = Path(json.loads(line.partition("=")[2])[0])
        given = given.replace(line, f'sources = ["{(CASES_AT / folder / name).resolve()}"]')
    for line in [line for line in given.splitlines() if line.startswith("fmu")]:
        given = given.replace(line, f'fmu = "{(CASES_AT / folder / json.loads(line.partition("=")[2])).resolve()}"')
    (out / "rig.toml").write_text(given)
    arguments: list[object] = ["--config", out / "rig.toml", "--out", out / "out"]
    for name in data:
        arguments += ["--data", CASES_AT / folder / name]
    done = CliRunner().invoke(main, ["fit", "--workers", "1", "--quiet", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    assert "Checks:" in done.output
    result: dict[str, Any] = json.loads((out / "out" / "result.json").read_text())
    assert [row["cause"] for row in result["diagnosis"]] == ["data", "solver", "search", "noise", "model"]
    return result


@dataclass(frozen=True)
class Case:
    """A situation: its files, the values with their largest relative error, the causes found, and what is told.

    ``numbers`` are told after these words, with their largest relative error; ``clean`` readings have no outliers."""

    config: str
    data: list[str]
    values: Mapping[str, float] = field(default_factory=dict)
    share: float = 0.01
    causes: tuple[str, ...] = ()
    told: tuple[str, ...] = ()
    numbers: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    columns: str = ""
    clean: bool = False


ROOM = {"C": 2.0e6, "G": 120.0}
WALLS = {"C": 6e5, "Cw": 4e6, "G": 110.0, "Gw": 180.0}
BATTERY = {"R0": 0.032, "R1": 0.021, "C1": 1800.0, "Q": 2.0}
BLOCK = {"plant/Gain.k(1)": 2.6, "plant/Time constant [s]": 1.4}
DATA = ("data",)
CASES = {
    "06_historian_words": [
        Case("sentinel_csv.toml", ["sentinel.csv"], ROOM, 0.05, DATA, ("-999", "52 to 53, 302")),
    ],
    "18_wrapped_angle": [
        Case("wrapped.toml", ["run.csv"], told=("whole turn", "unwrap")),
        Case("wrapped.toml", ["run.csv"], {"J": 0.03, "d": 0.05}, 0.03, columns="phi = {unwrap = true}"),
    ],
    "25_outlier_tail": [Case("rig.toml", ["run.csv"], ROOM, 0.03, DATA, ("outliers", "2640"))],
    "30_csv_dialects": [Case("quality.toml", ["quality.csv"], ROOM, 0.03, DATA, ("marked as bad",))],
    "32_relative_noise": [Case("rig.toml", ["run.csv"], {"k": 0.5}, 0.01, ("noise",), ("grows with the reading",))],
    "34_dropped_clock": [Case("rig.toml", ["run.csv"], ROOM, 0.02, DATA, ("23869",))],
    "37_current_sign": [
        Case("rig.toml", ["run.csv"], told=("I looks counted the other way round", "scale = -1"), clean=True),
        Case("rig.toml", ["run.csv"], BATTERY, columns="I = {scale = -1.0}"),
    ],
    "39_known_per_run": [
        Case("rig.toml", ["light.csv", "heavy.csv"], told=("m seems to differ from recording",), clean=True)
    ],
    "10_condition_specific": [
        Case("rig.toml", ["empty.csv", "loaded.csv"], told=("C seems to differ from recording",))
    ],
    "49_table_values": [Case("later.toml", ["run.csv"], told=("e[1], e[2], e[3], e[4], e[5] and e[6] are held",))],
    "46_block_fmu": [
        Case("pump.toml", ["run.csv"], BLOCK, 2e-3),
        Case("silent.toml", ["slow.csv"], BLOCK, 2e-3),
        Case("latin1.toml", ["odd.csv"], BLOCK, 2e-3),
    ],
    "56_own_outputs": [
        Case("rig.toml", data, WALLS, 0.02)
        for data in (["room.csv", "wall.csv"], ["room2.csv", "wall2.csv"], ["lateout.csv"])
    ],
    "62_gauge_and_celsius": [
        Case("receiver.toml", ["gauge.csv"], numbers={"with ": (101325.0, 0.005), "k = ": (1e-8, 0.005)})
    ],
    "64_interval_means": [
        Case(
            "rig.toml",
            ["end.csv"],
            told=("P looks like a mean over the interval before",),
            numbers={"C = ": (2.5e5, 0.01)},
        )
    ],
    "79_prior_conflict": [
        Case("rig.toml", ["run.csv"], told=("The readings contradict",), numbers={"m = ": (1.5, 0.01)})
    ],
    "83_held_output": [Case("rig.toml", ["run.csv"], {"K": 180.0}, 0.01, DATA, ("0.5 s",))],
}


@pytest.mark.parametrize(
    ("folder", "case"), [pytest.param(f, c, id=f"{f}-{k}") for f, own in CASES.items() for k, c in enumerate(own)]
)
def test_the_cause_is_named_and_the_values_are_right(folder: str, case: Case, tmp_path: Path) -> None:
    result = fitted(folder, case.config, case.data, tmp_path, case.columns)
    for name, value in case.values.items():
        assert result["parameters"][name]["value"] == pytest.approx(value, rel=case.share), name
    found = [row for row in result["diagnosis"] if row["found"]]
    if case.values or case.causes:
        assert tuple(row["cause"] for row in found) == case.causes
    for words in case.told:
        assert words in " ".join(found[0][key] for key in ("what", "where", "done"))
    for words, (number, share) in case.numbers.items():
        assert float(found[0]["what"].split(words)[1].split(" ")[0]) == pytest.approx(number, rel=share)
    if case.clean:
        assert "outliers" not in str(found)


READINGS = Layout.of(["P", "T_amb"], ["T"])


@pytest.mark.parametrize(("name", "needs"), [("run.xlsx", "openpyxl"), ("run.parquet", "pyarrow")])
def test_07_tables_of_excel_and_parquet(name: str, needs: str) -> None:
    pytest.importorskip(needs)
    read = aero_bayes.read_recording(CASES_AT / "07_excel_parquet" / name, layout=READINGS)
    plain = aero_bayes.read_recording(CASES_AT / "plain.csv", layout=READINGS)
    assert read.time - read.time[0] == pytest.approx(plain.time - plain.time[0], abs=1e-3)
    assert read.outputs["T"] == pytest.approx(plain.outputs["T"])


@pytest.mark.parametrize("resolution", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
def test_07_dates_in_any_resolution_are_seconds(resolution: str, zone: str | None) -> None:
    plain = aero_bayes.read_recording(CASES_AT / "plain.csv", layout=READINGS)
    began = pandas.Timestamp("2026-10-24T18:00", tz=zone)  # over the end of summer time
    index = (began + pandas.to_timedelta(plain.time, unit="s")).as_unit(resolution)
    frame = plain.to_frame().set_index(index)
    read = aero_bayes.Recording.from_frame(frame, inputs=["P", "T_amb"], outputs=["T"])
    assert read.time == pytest.approx(plain.time, abs=1e-3)


@pytest.mark.parametrize(
    "form",
    ["clock.csv", "excel_serial.csv", "fortran.csv", "labview.lvm", "long.csv", "ms_epoch.csv", "sep.csv", "spaces.csv",
     "thousands_de.csv", "thousands_en.csv"],
)  # fmt: skip
def test_30_forms_of_a_log_are_read(form: str) -> None:
    clock = {"time": ColumnMap("X_Value")} if form == "labview.lvm" else {}
    read = aero_bayes.read_recording(CASES_AT / "30_csv_dialects" / form, clock, layout=READINGS)
    plain = aero_bayes.read_recording(CASES_AT / "plain.csv", layout=READINGS)
    assert read.time - read.time[0] == pytest.approx(plain.time[: read.rows] - plain.time[0], abs=0.05)
    assert read.outputs["T"] == pytest.approx(plain.outputs["T"][: read.rows], abs=0.01)
    assert read.inputs["P"] == pytest.approx(plain.inputs["P"][: read.rows])


@pytest.mark.parametrize(("form", "words"), [("two_clocks.csv", "resample"), ("dup_col.csv", "T")])
def test_30_what_cannot_be_read_is_refused_in_a_line(form: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        aero_bayes.read_recording(CASES_AT / "30_csv_dialects" / form, layout=READINGS)
    assert "\n" not in str(refused.value)


def closed(folder: str, config: str, data: str, out: Path) -> dict[str, Any]:
    """The result of a loop on one recording."""
    arguments = ["--config", CASES_AT / folder / config, "--train", CASES_AT / folder / data, "--out", out]
    done = CliRunner().invoke(main, ["close-loop", "--workers", "1", "--quiet", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    result: dict[str, Any] = json.loads((out / "result.json").read_text())
    return result


@pytest.mark.long
def test_18_the_loop_looks_for_no_effect_in_an_angle_modulo_a_turn(tmp_path: Path) -> None:
    result = closed("18_wrapped_angle", "wrapped.toml", "run.csv", tmp_path)
    assert (result["loop"]["outcome"], result["loop"]["effects"]) == ("unexplained", [])
    assert "whole turn" in result["verdict"]["text"]


@pytest.mark.long
@pytest.mark.parametrize("folder", ["25_outlier_tail", "32_relative_noise"])
def test_the_loop_finds_a_right_model_adequate_whatever_its_noise(folder: str, tmp_path: Path) -> None:
    result = closed(folder, "rig.toml", "run.csv", tmp_path)
    assert result["loop"]["outcome"] == "adequate"
    assert {error["verdict"] for error in result["loop"]["errors"]} == {"noise"}


@pytest.mark.long
def test_56_a_sensor_that_was_mounted_late_is_held_out_in_part(tmp_path: Path) -> None:
    assert closed("56_own_outputs", "rig.toml", "lateout.csv", tmp_path)["loop"]["effects"] == []


@pytest.mark.parametrize("data", ["run.csv", "k20.csv", "k30.csv"])
def test_24_few_readings_among_many_rows(data: str, tmp_path: Path) -> None:
    result = fitted("24_sparse_output", "rig.toml", [data], tmp_path)
    for name, truth in ROOM.items():
        entry = result["parameters"][name]
        assert abs(entry["value"] - truth) < 4.0 * entry["sd"]
    assert not any(row["found"] for row in result["diagnosis"])


def test_55_two_sensors_of_one_output(tmp_path: Path) -> None:
    both = fitted("55_two_sensor_grades", "rig.toml", ["good.csv", "poor.csv"], tmp_path)
    good = fitted("55_two_sensor_grades", "rig.toml", ["good.csv"], tmp_path)
    for name, truth in (("m", 1150.0), ("d", 31.0)):
        assert abs(both["parameters"][name]["value"] - truth) < 3.0 * both["parameters"][name]["sd"]
        assert both["parameters"][name]["sd"] < 1.02 * good["parameters"][name]["sd"]
    assert both["noise"]["v"]["by_recording"] == pytest.approx({"good": 0.02, "poor": 0.4}, rel=0.1)
    assert [row["cause"] for row in both["diagnosis"] if row["found"]] == ["noise"]


def test_81_a_thermostat_shows_ratios_only(tmp_path: Path) -> None:
    result = fitted("81_switch_output", "T.toml", ["run.csv"], tmp_path)
    assert any("common change" in sentence for sentence in result["identifiability"]["flat"])
    for name, true in (("C", 3e4), ("G", 2.2), ("P", 130.0)):
        own = result["parameters"][name]
        assert own["status"] != "identified"
        assert own["q05"] < true < own["q95"]
