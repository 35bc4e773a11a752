"""``aero-bayes design`` end to end: the signal it writes, the gain it expects and finds, and what it refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from aero_bayes.cli import main
from aero_bayes.data import write_csv
from aero_bayes.modelica.compilers import export_fmu
from simulated_rigs.aero import Truth, pivot_friction, simulate_recording
from simulated_rigs.designs import pulse
from simulated_rigs.sensors import white

QUICK = "[fit]\nmethod = 'local'\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("design")


@pytest.fixture(scope="module")
def fmu(folder: Path) -> Path:
    return export_fmu("Aero.Systems.OneDof", folder / "OneDof.fmu")


@pytest.fixture(scope="module")
def short(folder: Path) -> Path:
    """A pulse too short to say much of the body."""
    rng = np.random.default_rng(11)
    truth = Truth((pivot_friction(0.5e-3),), 0.006)
    made = simulate_recording(truth, pulse(8.0, 1.0, 4.0), white(1.0), rng, duration=8.0, rate_hz=50.0)
    return write_csv(made, folder / "short.csv")


@pytest.fixture(scope="module")
def config(folder: Path) -> Path:
    path = folder / "study.toml"
    path.write_text(QUICK)
    return path


def design(out: Path, *arguments: object) -> Result:
    words = ["design", *map(str, arguments), "--out", str(out), "--quiet"]
    return CliRunner().invoke(main, words)


def signal_of(out: Path) -> tuple[np.ndarray, np.ndarray]:
    with (out / "next_experiment.csv").open() as file:
        rows = list(csv.DictReader(file))
    return np.array([float(r["time"]) for r in rows]), np.array([float(r["V_m"]) for r in rows])


def test_weak_parameters_get_an_experiment_that_keeps_its_word(
    folder: Path, fmu: Path, short: Path, config: Path
) -> None:
    out = folder / "narrow"
    result = design(
        out, "--data", short, "--model", fmu, "--config", config, "--aim", "D_p", "--aim", "K_sp", "--duration", 12,
        "--amplifier", 10, "--travel", "theta=0.3", "--workers", 1,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    time, volts = signal_of(out)
    assert np.allclose(np.diff(time), 0.02)
    assert time[-1] == pytest.approx(12.0)
    assert np.max(np.abs(volts)) <= 10.0
    found: dict[str, Any] = json.loads((out / "result.json").read_text("utf-8"))
    assert (found["schema"], found["command"]) == (1, "design")
    plan = found["design"]
    assert plan["travel"]["theta"] <= 0.3
    assert {name for name, entry in plan["parameters"].items() if entry["target"]} == {"D_p", "K_sp"}
    for name in ("D_p", "K_sp"):
        entry = plan["parameters"][name]
        assert entry["sd_after"] < entry["sd_before"]
        assert entry["unit"] == found["parameters"][name]["unit"]
    page = (out / "report.html").read_text("utf-8")
    assert 'id="design"' in page
    assert "next_experiment.csv" in page


@pytest.mark.parametrize("travel", ["theta", "theta=far"])
def test_travel_that_is_no_number(travel: str, tmp_path: Path, fmu: Path, short: Path) -> None:
    result = design(tmp_path / "out", "--data", short, "--model", fmu, "--travel", travel)
    assert result.exit_code == 2
    assert "y=0.5" in result.stderr
