"""Situations from public bug reports whose equations are right: right values, the cause named, the model not blamed."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pandas
import pytest
from click.testing import CliRunner

import aero_bayes
from aero_bayes.cli import main
from aero_bayes.data import ColumnMap, Layout
from aero_bayes.errors import InputError

CASES = Path(os.environ.get("AERO_BAYES_CASES", Path(__file__).parents[2].parent / "shared" / "cases"))
pytestmark = [pytest.mark.skipif(not CASES.is_dir(), reason=f"no cases at {CASES}"), pytest.mark.fast]


def fitted(folder: str, config: str, data: str | list[str], out: Path, text: str = "") -> dict[str, Any]:
    """The result of ``fit`` to one or more files; ``text`` is put in place of the empty table of columns."""
    given = (CASES / folder / config).read_text()
    given = given.replace("[data.columns]", f"[data.columns]\n{text}", 1)
    for line in [line for line in given.splitlines() if line.startswith("sources")]:
        name = Path(json.loads(line.partition("=")[2])[0])
        given = given.replace(line, f'sources = ["{(CASES / folder / name).resolve()}"]')
    for line in [line for line in given.splitlines() if line.startswith("fmu")]:
        given = given.replace(line, f'fmu = "{(CASES / folder / json.loads(line.partition("=")[2])).resolve()}"')
    (out / "rig.toml").write_text(given)
    arguments: list[object] = ["--config", out / "rig.toml", "--out", out / "out"]
    for name in [data] if isinstance(data, str) else data:
        arguments += ["--data", CASES / folder / name]
    done = CliRunner().invoke(main, ["fit", "--workers", "1", "--quiet", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    assert "Checks:" in done.output
    result: dict[str, Any] = json.loads((out / "out" / "result.json").read_text())
    assert [row["cause"] for row in result["diagnosis"]] == ["data", "solver", "search", "noise", "model"]
    return result


def assert_room(result: dict[str, Any], share: float) -> None:
    assert result["parameters"]["C"]["value"] == pytest.approx(2.0e6, rel=share)
    assert result["parameters"]["G"]["value"] == pytest.approx(120.0, rel=share)


def causes(result: dict[str, Any]) -> list[str]:
    return [row["cause"] for row in result["diagnosis"] if row["found"]]


def test_06_a_dead_sensor(tmp_path: Path) -> None:
    result = fitted("06_historian_words", "sentinel_csv.toml", "sentinel.csv", tmp_path)
    assert_room(result, 0.05)
    assert causes(result) == ["data"]
    assert "-999" in result["diagnosis"][0]["what"]
    assert "52 to 53, 302" in result["diagnosis"][0]["where"]


READINGS = Layout.of(["P", "T_amb"], ["T"])


@pytest.mark.parametrize(("name", "needs"), [("run.xlsx", "openpyxl"), ("run.parquet", "pyarrow")])
def test_07_tables_of_excel_and_parquet(name: str, needs: str) -> None:
    pytest.importorskip(needs)
    read = aero_bayes.read_recording(CASES / "07_excel_parquet" / name, layout=READINGS)
    plain = aero_bayes.read_recording(CASES / "plain.csv", layout=READINGS)
    assert read.time - read.time[0] == pytest.approx(plain.time - plain.time[0], abs=1e-3)
    assert read.outputs["T"] == pytest.approx(plain.outputs["T"])


@pytest.mark.parametrize("resolution", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
def test_07_dates_in_any_resolution_are_seconds(resolution: str, zone: str | None) -> None:
    plain = aero_bayes.read_recording(CASES / "plain.csv", layout=READINGS)
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
    read = aero_bayes.read_recording(CASES / "30_csv_dialects" / form, clock, layout=READINGS)
    plain = aero_bayes.read_recording(CASES / "plain.csv", layout=READINGS)
    assert read.time - read.time[0] == pytest.approx(plain.time[: read.rows] - plain.time[0], abs=0.05)
    assert read.outputs["T"] == pytest.approx(plain.outputs["T"][: read.rows], abs=0.01)
    assert read.inputs["P"] == pytest.approx(plain.inputs["P"][: read.rows])


@pytest.mark.parametrize(("form", "words"), [("two_clocks.csv", "resample"), ("dup_col.csv", "T")])
def test_30_what_cannot_be_read_is_refused_in_a_line(form: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        aero_bayes.read_recording(CASES / "30_csv_dialects" / form, layout=READINGS)
    assert "\n" not in str(refused.value)


def test_30_readings_that_the_logger_calls_bad_are_not_fitted(tmp_path: Path) -> None:
    result = fitted("30_csv_dialects", "quality.toml", "quality.csv", tmp_path)
    assert_room(result, 0.03)
    assert causes(result) == ["data"]
    assert "marked as bad" in result["diagnosis"][0]["what"]


def test_18_an_angle_modulo_a_turn(tmp_path: Path) -> None:
    result = fitted("18_wrapped_angle", "wrapped.toml", "run.csv", tmp_path)
    assert "whole turn" in result["verdict"]["text"]
    assert "unwrap" in result["diagnosis"][0]["done"]
    mended = fitted("18_wrapped_angle", "wrapped.toml", "run.csv", tmp_path, "phi = {unwrap = true}")
    assert mended["parameters"]["J"]["value"] == pytest.approx(0.03, rel=0.03)
    assert mended["parameters"]["d"]["value"] == pytest.approx(0.05, rel=0.03)
    assert causes(mended) == []


@pytest.mark.parametrize("data", ["run.csv", "k20.csv", "k30.csv"])
def test_24_few_readings_among_many_rows(data: str, tmp_path: Path) -> None:
    result = fitted("24_sparse_output", "rig.toml", data, tmp_path)
    for name, truth in (("C", 2.0e6), ("G", 120.0)):
        entry = result["parameters"][name]
        assert abs(entry["value"] - truth) < 4.0 * entry["sd"]
    assert causes(result) == []


def test_25_outliers(tmp_path: Path) -> None:
    result = fitted("25_outlier_tail", "rig.toml", "run.csv", tmp_path)
    assert_room(result, 0.03)
    assert causes(result) == ["data"]
    assert "outliers" in result["diagnosis"][0]["what"]
    assert "2640" in result["diagnosis"][0]["where"]


def test_34_a_logger_that_lost_three_hours(tmp_path: Path) -> None:
    result = fitted("34_dropped_clock", "rig.toml", "run.csv", tmp_path)
    assert_room(result, 0.02)
    assert causes(result) == ["data"]
    assert "23869" in result["diagnosis"][0]["what"]
    given = CASES / "34_dropped_clock"
    told = CliRunner().invoke(main, ["check", str(given / "run.csv"), "--config", str(given / "rig.toml")])
    assert "90 samples missing" in told.output


@pytest.mark.long
def test_18_the_loop_looks_for_no_effect_in_an_angle_modulo_a_turn(tmp_path: Path) -> None:
    folder = CASES / "18_wrapped_angle"
    arguments = ["--config", folder / "wrapped.toml", "--train", folder / "run.csv", "--out", tmp_path]
    done = CliRunner().invoke(main, ["close-loop", "--workers", "1", "--quiet", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["loop"]["outcome"] == "unexplained"
    assert result["loop"]["effects"] == []
    assert "whole turn" in result["verdict"]["text"]


def assert_values(result: dict[str, Any], share: float, **truth: float) -> None:
    for name, value in truth.items():
        assert result["parameters"][name]["value"] == pytest.approx(value, rel=share), name


def test_32_noise_that_grows_with_the_reading_over_four_decades(tmp_path: Path) -> None:
    result = fitted("32_relative_noise", "rig.toml", "run.csv", tmp_path)
    assert_values(result, 0.01, k=0.5)
    assert result["noise"]["c"]["kind"] == "relative"
    assert result["noise"]["c"]["per_unit"] == pytest.approx(0.05, rel=0.2)
    assert abs(result["noise"]["c"]["base"]) < 1e-3
    assert causes(result) == ["noise"]


def test_37_a_current_that_is_counted_the_other_way_round(tmp_path: Path) -> None:
    result = fitted("37_current_sign", "rig.toml", "run.csv", tmp_path)
    assert result["diagnosis"][0]["what"].startswith("I looks counted the other way round")
    assert "scale = -1" in result["diagnosis"][0]["done"]
    assert "outliers" not in str(result["diagnosis"])
    right = fitted("37_current_sign", "rig.toml", "run.csv", tmp_path, "I = {scale = -1.0}")
    assert_values(right, 0.01, R0=0.032, R1=0.021, C1=1800.0, Q=2.0)
    assert causes(right) == []


def test_39_a_mass_that_differs_by_run_is_told_and_clean_readings_are_no_outliers(tmp_path: Path) -> None:
    result = fitted("39_known_per_run", "rig.toml", ["light.csv", "heavy.csv"], tmp_path)
    assert result["diagnosis"][0]["what"].startswith("m seems to differ from recording to recording")
    assert "outliers" not in str(result["diagnosis"])


def test_10_a_capacity_that_differs_by_recording_is_told(tmp_path: Path) -> None:
    result = fitted("10_condition_specific", "rig.toml", ["empty.csv", "loaded.csv"], tmp_path)
    assert result["diagnosis"][0]["what"].startswith("C seems to differ from recording to recording")


def test_49_held_values_of_a_table_are_told_before_the_model_is_blamed(tmp_path: Path) -> None:
    result = fitted("49_table_values", "later.toml", "run.csv", tmp_path)
    assert result["diagnosis"][0]["what"].startswith("e[1], e[2], e[3], e[4], e[5] and e[6] are held")


@pytest.mark.long
@pytest.mark.parametrize("folder", ["25_outlier_tail", "32_relative_noise"])
def test_the_loop_finds_a_right_model_adequate_whatever_its_noise(folder: str, tmp_path: Path) -> None:
    arguments = ["--config", CASES / folder / "rig.toml", "--train", CASES / folder / "run.csv", "--out", tmp_path]
    done = CliRunner().invoke(main, ["close-loop", "--workers", "1", "--quiet", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["loop"]["outcome"] == "adequate"
    assert {error["verdict"] for error in result["loop"]["errors"]} == {"noise"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("config", "data"), [("pump.toml", "run.csv"), ("silent.toml", "slow.csv"), ("latin1.toml", "odd.csv")]
)
def test_46_a_co_simulation_of_one_step_size(config: str, data: str, tmp_path: Path) -> None:
    result = fitted("46_block_fmu", config, data, tmp_path)
    assert_values(result, 2e-3, **{"plant/Gain.k(1)": 2.6, "plant/Time constant [s]": 1.4})
    assert causes(result) == []


def test_55_two_sensors_of_one_output(tmp_path: Path) -> None:
    both = fitted("55_two_sensor_grades", "rig.toml", ["good.csv", "poor.csv"], tmp_path)
    good = fitted("55_two_sensor_grades", "rig.toml", "good.csv", tmp_path)
    for name, truth in (("m", 1150.0), ("d", 31.0)):
        assert abs(both["parameters"][name]["value"] - truth) < 3.0 * both["parameters"][name]["sd"]
        assert both["parameters"][name]["sd"] < 1.02 * good["parameters"][name]["sd"]
    assert both["noise"]["v"]["by_recording"] == pytest.approx({"good": 0.02, "poor": 0.4}, rel=0.1)
    assert causes(both) == ["noise"]
    assert causes(good) == []


@pytest.mark.parametrize("data", [["room.csv", "wall.csv"], ["room2.csv", "wall2.csv"], ["lateout.csv"]])
def test_56_recordings_of_different_outputs(data: list[str], tmp_path: Path) -> None:
    result = fitted("56_own_outputs", "rig.toml", data, tmp_path)
    assert_values(result, 0.02, C=6e5, Cw=4e6, G=110.0, Gw=180.0)
    assert causes(result) == []


@pytest.mark.long
def test_56_a_sensor_that_was_mounted_late_is_held_out_in_part(tmp_path: Path) -> None:
    folder = CASES / "56_own_outputs"
    arguments = ["--config", folder / "rig.toml", "--train", folder / "lateout.csv", "--out", tmp_path]
    done = CliRunner().invoke(main, ["close-loop", "--workers", "1", "--quiet", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "result.json").read_text())["loop"]["effects"] == []


def test_62_a_gauge_for_absolute_pressure(tmp_path: Path) -> None:
    result = fitted("62_gauge_and_celsius", "receiver.toml", "gauge.csv", tmp_path)
    first = result["diagnosis"][0]
    assert first["found"]
    added = float(first["what"].split("with ")[1].split(" Pa")[0])
    assert added == pytest.approx(101325.0, rel=0.005)
    assert float(first["what"].split("k = ")[1].split(" ")[0]) == pytest.approx(1e-8, rel=0.005)


def test_64_means_over_a_quarter_of_an_hour(tmp_path: Path) -> None:
    first = fitted("64_interval_means", "rig.toml", "end.csv", tmp_path)["diagnosis"][0]
    assert first["found"]
    assert first["what"].startswith("P looks like a mean over the interval before")
    assert float(first["what"].split("C = ")[1].split(" ")[0]) == pytest.approx(2.5e5, rel=0.01)


def test_79_a_prior_that_the_data_contradict(tmp_path: Path) -> None:
    first = fitted("79_prior_conflict", "rig.toml", "run.csv", tmp_path)["diagnosis"][0]
    assert first["found"]
    assert float(first["what"].split("m = ")[1].split(" ")[0]) == pytest.approx(1.5, rel=0.01)


def test_81_a_thermostat_shows_ratios_only(tmp_path: Path) -> None:
    result = fitted("81_switch_output", "T.toml", "run.csv", tmp_path)
    assert any("common change" in sentence for sentence in result["identifiability"]["flat"])
    for name, true in (("C", 3e4), ("G", 2.2), ("P", 130.0)):
        own = result["parameters"][name]
        assert own["status"] != "identified"
        assert own["q05"] < true < own["q95"]


def test_83_a_sensor_that_holds_its_value(tmp_path: Path) -> None:
    result = fitted("83_held_output", "rig.toml", "run.csv", tmp_path)
    assert result["parameters"]["T"]["q05"] < 1.2 < result["parameters"]["T"]["q95"]
    assert result["parameters"]["K"]["value"] == pytest.approx(180.0, rel=0.01)
    assert causes(result) == ["data"]
    assert "0.5 s" in result["diagnosis"][0]["what"]
