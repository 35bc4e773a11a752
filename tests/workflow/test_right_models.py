"""Situations from public bug reports in which the equations are right: what a user gets who runs the command line."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import aero_bayes
from aero_bayes.cli import main
from aero_bayes.errors import InputError

CASES = Path(os.environ.get("AERO_BAYES_CASES", Path(__file__).parents[2].parent / "shared" / "cases"))
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason=f"no cases at {CASES}")

Values = dict[str, tuple[float, float]]
OWN = ("C = {free = true,", "C = {free = true, per_recording = true,")
KNOWN = "m = {free = false, value = 1.0}"
BY_RUN = (KNOWN, "m = {value = {light = 1.0, heavy = 2.5}}")
#: Configuration, recordings, right values with their largest relative error, and what of the file is replaced.
FITS: list[tuple[str, str, list[str], Values, tuple[str, str]]] = [
    ("09_sign_friction", "Sledge.toml", ["run.csv"], {"k": (56.0, 1e-3), "F_c": (0.4, 1e-2)}, ("", "")),
    ("09_sign_friction", "SledgeIf.toml", ["run.csv"], {"k": (56.0, 1e-3), "F_c": (0.4, 1e-2)}, ("", "")),
    ("10_condition_specific", "rig.toml", ["empty.csv", "loaded.csv"],
     {"C@empty": (2.0e6, 0.01), "C@loaded": (3.5e6, 0.01), "G": (120.0, 0.005)}, OWN),
    ("11_initial_parameter", "t0.toml", ["run.csv"], {"T0": (288.0, 7e-5)}, ("", "")),
    ("11_initial_parameter", "t0r.toml", ["run.csv"], {"T0": (288.0, 7e-5)}, ("", "")),
    ("33_sqrt_domain", "handm.toml", ["run.csv"], {"A": (0.5, 0.05), "a": (0.002, 0.05)}, ("", "")),
    ("35_files_of_one_run", "rig.toml", ["actuator_controls_0_0.csv", "vehicle_angular_velocity_0.csv"],
     {"K": (9.0, 0.01), "T": (0.12, 0.01)}, ("", "")),
    # counted lines stand above the names
    ("36_eclab_mpt", "rig.toml", ["run.mpt"], {"R0": (0.032, 0.01), "R1": (0.021, 0.01), "C1": (1800.0, 0.01)},
     ("", "")),
    ("39_known_per_run", "rig.toml", ["light.csv", "heavy.csv"],
     {"k": (180.0, 0.001), "d": (0.6, 0.001), "m@light": (1.0, 0.0), "m@heavy": (2.5, 0.0)},
     BY_RUN),
    ("51_records_and_options", "rig.toml", ["run.csv"], {"tank.data.V": (0.12, 0.01), "tank.data.U[3]": (3.5, 0.01)},
     ("", "")),
    ("51_records_and_options", "element.toml", ["element.csv"], {"s.a[2]": (2.7, 0.01)}, ("", "")),
]  # fmt: skip
ROOM, ROLL = {"C": (2.0e6, 0.01), "G": (120.0, 0.01)}, {"K": (9.0, 0.01), "T": (0.12, 0.01)}
TABLE = {f"e[{k}]": (e, 0.0012) for k, e in enumerate((3.02, 3.47, 3.61, 3.69, 3.88, 4.17), 1)} | {"R": (0.045, 0.03)}
#: Files of loggers, whose lines beside the table are told but for the last's: a separator too many goes without saying.
LOGGERS = ("campbell.dat", "canape.csv", "foot.csv", "hobo.csv", "scope.csv", "trailing.csv")
#: Model and recording that ``init`` is given, and the values of a fit with what it wrote.
STARTS: list[tuple[str, list[str], Values]] = [
    ("35_files_of_one_run", ["Roll.mo", "joined.csv"], ROLL),  # two clocks
    ("35_files_of_one_run", ["Roll.mo", "pairs.csv"], ROLL),
    ("30_csv_dialects", ["../Room.mo", "long.csv"], ROOM),  # a column names the signals
    ("49_table_values", ["Map.mo", "run.csv", "--model", "MapIf"], TABLE),  # the break points of a table are held
    *(("53_logger_preambles", ["../Room.mo", logger], ROOM) for logger in LOGGERS),
]  # fmt: skip


@pytest.fixture
def case(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the case's folder, in which commands run."""
    folder = Path(shutil.copytree(CASES / request.param, tmp_path / "case"))
    shutil.copy(CASES / "Room.mo", tmp_path)
    monkeypatch.chdir(folder)
    return folder


def run(*words: str) -> Result:
    return CliRunner().invoke(main, [*words])


def fitted(config: str, *data: str, command: str = "fit", option: str = "--data") -> tuple[dict[str, Any], str]:
    """Result and output of a run in the folder ``out``, which does not blame the model, at most the solver."""
    files = [word for path in data for word in (option, path)]
    done = run(command, "--config", config, *files, "--out", "out", "--workers", "1", "--seed", "1")
    assert done.exit_code == 0, done.output
    result: dict[str, Any] = json.loads(Path("out", "result.json").read_text("utf-8"))
    found = {row["cause"] for row in result["diagnosis"] if row["found"]}
    assert "model" not in found or "solver" in found
    return result, done.output


def assert_values(result: dict[str, Any], values: Values) -> None:
    for name, (value, share) in values.items():
        assert result["parameters"][name]["value"] == pytest.approx(value, rel=share), name


@pytest.mark.parametrize(("case", "config", "data", "values", "replaced"), FITS, indirect=["case"])
def test_values_are_right_and_the_written_model_has_them(
    case: Path, config: str, data: list[str], values: Values, replaced: tuple[str, str]
) -> None:
    text = Path(config).read_text("utf-8")
    assert replaced[0] in text
    Path(config).write_text(text.replace(*replaced) if replaced[0] else text, "utf-8")
    result, _ = fitted(config, *data)
    assert_values(result, values)
    (written,) = Path("out").glob("*_fitted.mo")
    again = aero_bayes.load_model(written, sources=list(case.glob("*.mo")))
    for name in values:
        if "@" not in name:
            assert again.parameter(name).start == pytest.approx(result["parameters"][name]["value"], rel=1e-9)


@pytest.mark.parametrize(("case", "given", "values"), STARTS, indirect=["case"])
def test_what_init_writes_fits_a_file_in_any_form(case: Path, given: list[str], values: Values) -> None:
    written = run("init", *given, "--out", "new.toml")
    assert written.exit_code == 0, written.output
    assert ("not read" in written.output) == (given[1] in LOGGERS[:-1])
    assert_values(fitted("new.toml", given[1])[0], values)


@pytest.mark.parametrize("case", ["39_known_per_run"], indirect=True)
def test_recordings_of_one_rig_predict_each_other_to_the_noise(case: Path) -> None:
    Path("rig.toml").write_text(Path("rig.toml").read_text().replace(*BY_RUN))
    result, _ = fitted("rig.toml", "light.csv", "heavy.csv")
    left_out = result["prediction"]["recordings"]
    assert set(left_out) == {"light", "heavy"}
    for entry in left_out.values():
        for output, error in entry["rms"].items():
            assert entry["rms_fitted"][output] <= error * (1.0 + 1e-6)
            assert error < 1.1 * entry["rms_fitted"][output]
    own = {name: entry["recording"] for name, entry in result["parameters"].items() if entry["recording"]}
    assert set(own.values()) == {"light", "heavy"}
    assert all(recording in name for name, recording in own.items())


@pytest.mark.parametrize("case", ["08_structural_parameter"], indirect=True)
def test_a_parameter_that_selects_a_branch(case: Path) -> None:
    result, _ = fitted("lim8.toml", "run.csv")
    assert_values(result, {"A": (0.8, 0.01)})
    assert aero_bayes.load_model("out/Tank_fitted.fmu").parameter("limit").start < 1.0
    result, _ = fitted("lim8.toml", "run.csv", command="close-loop", option="--train")
    assert result["loop"]["effects"] == []
    assert result["parameters"]["limit"]["value"] < 1.0


@pytest.mark.parametrize("case", ["17_noise_free"], indirect=True)
def test_data_without_noise(case: Path) -> None:
    result, _ = fitted("rig.toml", "run.csv")
    assert_values(result, {"C": (2.0e6, 1e-6), "G": (120.0, 1e-6)})
    assert result["residual"]["run"]["T"]["exact"] is True
    loop = fitted("rig.toml", "run.csv", command="close-loop", option="--train")[0]["loop"]
    assert loop["outcome"] == "adequate"
    assert loop["simulations"] < 5000


@pytest.mark.long
@pytest.mark.parametrize("case", ["33_sqrt_domain"], indirect=True)
def test_runs_that_leave_the_domain_of_a_root(case: Path) -> None:
    result, said = fitted("hand.toml", "run.csv")
    solver = result["diagnosis"][1]
    assert solver["found"]
    for word in ("root of a negative number", "sqrt of h", "Drain.mo:7"):
        assert word in solver["what"]
        assert word in said
    assert " s with the start values" in solver["where"]


@pytest.mark.parametrize(("name", "parameter"), [("sign", "b"), ("twin", "tau_a")])
@pytest.mark.parametrize("case", ["14_twin_modes"], indirect=True)
def test_two_answers_are_told(case: Path, name: str, parameter: str) -> None:
    result, said = fitted(f"{name}.toml", f"{name}.csv")
    (mode,) = result["fit"]["modes"]
    own = {key: entry["value"] for key, entry in result["parameters"].items()}
    expected = -own[parameter] if name == "sign" else own["tau_b"]
    assert mode["values"][parameter] == pytest.approx(expected, rel=1e-3)
    assert "2 answers" in said
    assert "2 answers" in Path("out", "report.html").read_text("utf-8")


@pytest.mark.parametrize("case", ["39_known_per_run"], indirect=True)
@pytest.mark.parametrize(("given", "words"), [
    ("m = {free = false, per_recording = true}", ("m: per_recording", "value = {")),
    ("m = {value = {light = 1.0}}", ("m:", "heavy")),
    ("m = {value = {light = 1.0, heavy = 2.5}, free = true}", ("m:", "leave free out")),
])  # fmt: skip
def test_what_cannot_be_meant_is_refused(case: Path, given: str, words: tuple[str, ...]) -> None:
    Path("own.toml").write_text(Path("rig.toml").read_text().replace(KNOWN, given))
    done = run("fit", "--config", "own.toml", "--data", "light.csv", "--data", "heavy.csv", "--out", "out")
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert all(word in line for word in words), line


def test_the_derivative_of_an_input_is_named() -> None:
    with pytest.raises(InputError, match=r"^Meter.mo:9: .*derivative of 'E' is not known"):
        aero_bayes.load_model(CASES / "43_derivative_of_input" / "Meter.mo")
