"""Situations from public bug reports in which the equations are right: what a user gets who runs the command line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import aero_bayes
from aero_bayes.cli import main

CASES = Path(__file__).parents[3] / "shared" / "cases"
if not CASES.is_dir():
    CASES = Path(__file__).parents[4] / "shared" / "cases"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the recordings are kept beside the project, not in it")


class Run:
    """A run of the command line in a copy of a case's folder."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.out = folder / "out"
        seed = () if "--seed" in words else ("--seed", "1")
        self.done: Result = CliRunner().invoke(main, [*words, "--out", str(self.out), "--workers", "1", *seed])
        assert self.done.exception is None or isinstance(self.done.exception, SystemExit), self.done.output
        self.text = self.done.output

    @property
    def result(self) -> dict[str, Any]:
        assert self.done.exit_code == 0, self.text
        return json.loads((self.out / "result.json").read_text("utf-8"))

    def value(self, name: str) -> float:
        return float(self.result["parameters"][name]["value"])

    @property
    def model_blamed(self) -> bool:
        return "misses something" in self.text


@pytest.fixture
def case(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "case"
    shutil.copytree(CASES / request.param, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize("case", ["08_structural_parameter"], indirect=True)
def test_a_parameter_that_selects_a_branch(case: Path):
    run = Run(case, "fit", "--config", "lim8.toml", "--data", "run.csv")
    assert run.value("limit") < 1.0
    assert run.value("A") == pytest.approx(0.8, rel=0.01)
    assert run.result["fit"]["rms"]["train"]["h"] < 0.0022
    assert not run.model_blamed
    fitted = aero_bayes.load_model(run.out / "Tank_fitted.fmu")
    assert fitted.parameter("limit").start < 1.0
    shutil.copy(case / "Tank.mo", run.out)
    aero_bayes.export_fmu("Tank_fitted", case / "again.fmu", sources=[case / "Tank.mo", run.out / "Tank_fitted.mo"])
    loop = Run(case, "close-loop", "--config", "lim8.toml", "--train", "run.csv")
    assert loop.result["loop"]["effects"] == []
    assert loop.value("limit") < 1.0


@pytest.mark.parametrize("case", ["09_sign_friction"], indirect=True)
@pytest.mark.parametrize("config", ["Sledge.toml", "SledgeIf.toml"])
def test_dry_friction_written_by_the_sign_of_the_speed(case: Path, config: str):
    run = Run(case, "fit", "--config", config, "--data", "run.csv")
    assert run.value("k") == pytest.approx(56.0, rel=1e-3)
    assert run.value("F_c") == pytest.approx(0.4, rel=1e-2)
    assert run.result["fit"]["rms"]["train"]["s"] < 0.00025
    assert not run.model_blamed


@pytest.mark.parametrize("case", ["10_condition_specific"], indirect=True)
def test_a_parameter_that_differs_by_recording(case: Path):
    text = Path("rig.toml").read_text("utf-8")
    Path("own.toml").write_text(text.replace("C = {free = true,", "C = {free = true, per_recording = true,"))
    run = Run(case, "fit", "--config", "own.toml", "--data", "empty.csv", "--data", "loaded.csv")
    assert run.value("C@empty") == pytest.approx(2.0e6, rel=0.01)
    assert run.value("C@loaded") == pytest.approx(3.5e6, rel=0.01)
    assert run.value("G") == pytest.approx(120.0, rel=0.005)
    assert not run.model_blamed


@pytest.mark.parametrize("config", ["t0.toml", "t0r.toml", "rig.toml"])
@pytest.mark.parametrize("case", ["11_initial_parameter"], indirect=True)
def test_an_initial_value_that_is_a_parameter(case: Path, config: str):
    run = Run(case, "fit", "--config", config, "--data", "run.csv")
    if config != "rig.toml":  # there T0 is not free, and only written
        assert run.value("T0") == pytest.approx(288.0, abs=0.02)
        assert run.result["parameters"]["T0"]["status"] == "identified"
    assert aero_bayes.load_model(run.out / "RoomT0_fitted.fmu").parameter("T0").start == pytest.approx(288.0, abs=0.02)


@pytest.mark.parametrize("case", ["17_noise_free"], indirect=True)
def test_data_without_noise(case: Path):
    run = Run(case, "fit", "--config", "rig.toml", "--data", "run.csv")
    assert run.value("C") == pytest.approx(2.0e6, rel=1e-6)
    assert run.value("G") == pytest.approx(120.0, rel=1e-6)
    assert run.result["residual"]["run"]["T"]["exact"] is True
    assert "no noise at all" in run.result["verdict"]["text"]
    assert not run.model_blamed
    loop = Run(case, "close-loop", "--config", "rig.toml", "--train", "run.csv")
    assert loop.result["loop"]["outcome"] == "adequate"
    assert loop.result["loop"]["simulations"] < 5000


@pytest.mark.long
@pytest.mark.parametrize("case", ["33_sqrt_domain"], indirect=True)
def test_runs_that_leave_the_domain_of_a_root(case: Path):
    run = Run(case, "fit", "--config", "hand.toml", "--data", "run.csv")
    solver = run.result["diagnosis"][1]
    assert solver["found"]
    for word in ("root of a negative number", "sqrt of h", "Drain.mo:7"):
        assert word in solver["what"]
        assert word in run.text
    assert " s with the start values" in solver["where"]
    assert not run.model_blamed
    guarded = Run(case, "fit", "--config", "handm.toml", "--data", "run.csv")
    assert guarded.value("A") == pytest.approx(0.5, rel=0.05)
    assert guarded.value("a") == pytest.approx(0.002, rel=0.05)


@pytest.mark.parametrize(("name", "parameter"), [("sign", "b"), ("twin", "tau_a")])
@pytest.mark.parametrize("case", ["14_twin_modes"], indirect=True)
def test_two_answers_are_told(case: Path, name: str, parameter: str):
    run = Run(case, "fit", "--config", f"{name}.toml", "--data", f"{name}.csv")
    (mode,) = run.result["fit"]["modes"]
    own, other = run.value(parameter), mode["values"][parameter]
    expected = -own if name == "sign" else run.value("tau_b")
    assert other == pytest.approx(expected, rel=1e-3)
    assert "2 answers" in run.text
    assert "2 answers" in (run.out / "report.html").read_text("utf-8")
