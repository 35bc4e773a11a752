"""Files from public bug reports: what stands around a table, several files of a run, values known by run."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from aero_bayes.cli import main

CASES = Path(os.environ.get("AERO_BAYES_CASES", Path(__file__).parents[2].parent / "shared" / "cases"))
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason=f"no cases at {CASES}")


#: Files of loggers, whose lines beside the table are told but for the last's: a separator too many goes without saying.
LOGGERS = ("campbell.dat", "canape.csv", "foot.csv", "hobo.csv", "scope.csv", "trailing.csv")
ROOM, ROLL = {"C": 2.0e6, "G": 120.0}, {"K": 9.0, "T": 0.12}


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, [*map(str, words)])


def fitted(folder: Path, config: str, *data: str) -> dict[str, Any]:
    """The result of a fit, whose page does not blame the model."""
    files = [word for path in data for word in ("--data", folder / path)]
    done = run(
        "fit", "--config", folder / config, *files, "--out", folder / "out", "--workers", "1", "--seed", "1", "--quiet"
    )
    assert done.exit_code == 0, done.output
    assert "lacks an effect" not in done.output
    result: dict[str, Any] = json.loads((folder / "out" / "result.json").read_text("utf-8"))
    return result


def assert_values(result: dict[str, Any], share: float = 0.0, **expected: float) -> None:
    """Values within a share of the right ones, or within four standard deviations."""
    for name, value in expected.items():
        found = result["parameters"][name]
        assert abs(found["value"] - value) < max(share * value, 4.0 * (found["sd"] or 0.0)), (name, found)


@pytest.fixture
def case(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    shutil.copytree(CASES / request.param, tmp_path / "case")
    shutil.copy(CASES / "Room.mo", tmp_path / "Room.mo")
    return tmp_path / "case"


def started(case: Path, model: str, data: str) -> dict[str, Any]:
    """The result of ``init`` and ``fit`` with what it wrote."""
    written = run("init", case / model, case / data, "--out", case / "new.toml")
    assert written.exit_code == 0, written.output
    assert "matches" not in written.output
    assert ("not read" in written.output) == (data in LOGGERS[:-1])
    return fitted(case, "new.toml", data)


@pytest.mark.parametrize("case", ["35_files_of_one_run"], indirect=True)
def test_35_two_files_of_one_run(case: Path) -> None:
    result = fitted(case, "rig.toml", "actuator_controls_0_0.csv", "vehicle_angular_velocity_0.csv")
    assert_values(result, 0.01, K=9.0, T=0.12)


@pytest.mark.parametrize(("case", "model", "data", "expected"), [
    *(("35_files_of_one_run", "Roll.mo", data, ROLL) for data in ("joined.csv", "pairs.csv")),  # two clocks
    ("30_csv_dialects", "../Room.mo", "long.csv", ROOM),  # a column names the signals
    *(("53_logger_preambles", "../Room.mo", data, ROOM) for data in LOGGERS),
], indirect=["case"])  # fmt: skip
def test_what_init_writes_fits_a_file_in_any_form(
    case: Path, model: str, data: str, expected: dict[str, float]
) -> None:
    assert_values(started(case, model, data), 0.01, **expected)


@pytest.mark.parametrize("case", ["36_eclab_mpt"], indirect=True)
def test_36_counted_lines_above_the_names(case: Path) -> None:
    result = fitted(case, "rig.toml", "run.mpt")
    assert_values(result, 0.01, R0=0.032, R1=0.021, C1=1800.0)
    told = run("check", case / "run.mpt", "--config", case / "rig.toml")
    assert "row 13" in told.output
    assert fitted(case, "rig.toml", "clean.mpt")["parameters"]["C1"]["value"] == result["parameters"]["C1"]["value"]


@pytest.mark.parametrize("case", ["39_known_per_run"], indirect=True)
def test_39_a_mass_that_is_known_by_run(case: Path) -> None:
    text = (case / "rig.toml").read_text()
    (case / "own.toml").write_text(
        text.replace("m = {free = false, value = 1.0}", "m = {value = {light = 1.0, heavy = 2.5}}")
    )
    result = fitted(case, "own.toml", "light.csv", "heavy.csv")
    assert_values(result, 0.001, k=180.0, d=0.6)
    assert [row["value"] for name, row in result["parameters"].items() if name.startswith("m@")] == [1.0, 2.5]
    assert not any(row["found"] for row in result["diagnosis"])


@pytest.mark.parametrize("case", ["39_known_per_run"], indirect=True)
@pytest.mark.parametrize(("given", "words"), [
    ("m = {free = false, per_recording = true}", ("m: per_recording", "value = {")),
    ("m = {value = {light = 1.0}}", ("m:", "heavy")),
    ("m = {value = {light = 1.0, heavy = 2.5}, free = true}", ("m:", "leave free out")),
])  # fmt: skip
def test_39_what_cannot_be_meant_is_refused(case: Path, given: str, words: tuple[str, ...]) -> None:
    text = (case / "rig.toml").read_text()
    (case / "own.toml").write_text(text.replace("m = {free = false, value = 1.0}", given))
    files = [word for path in ("light.csv", "heavy.csv") for word in ("--data", case / path)]
    done = run("fit", "--config", case / "own.toml", *files, "--out", case / "out")
    assert done.exit_code == 2
    assert all(word in done.stderr for word in words), done.stderr
    assert len(done.stderr.splitlines()) == 1
