"""``aero-bayes design`` end to end: the signal it writes, and the gain that it expects."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aero_bayes.cli import main

CART = Path(__file__).parents[2] / "examples" / "cart"


def test_a_parameter_gets_an_experiment_that_keeps_its_word(tmp_path: Path) -> None:
    folder, out = Path(shutil.copytree(CART, tmp_path / "cart")), tmp_path / "out"
    (folder / "rig.toml").write_text((folder / "rig.toml").read_text() + 'method = "local"\n')
    arguments = ["--config", folder / "rig.toml", "--data", folder / "train.csv", "--out", out, "--workers", 1]
    arguments += ["--aim", "k", "--duration", 4, "--amplifier", 1.5, "--travel", "position=0.04", "--quiet"]
    done = CliRunner().invoke(main, ["design", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    time, force = np.loadtxt(out / "next_experiment.csv", delimiter=",", skiprows=1, unpack=True)
    assert np.allclose(np.diff(time), 0.02)
    assert abs(time[-1] - 4.0) < 0.021
    assert np.max(np.abs(force)) <= 1.5
    found = json.loads((out / "result.json").read_text("utf-8"))
    assert (found["schema"], found["command"]) == (1, "design")
    plan = found["design"]
    assert plan["travel"]["position"] <= 0.04
    assert {name for name, entry in plan["parameters"].items() if entry["target"]} == {"k"}
    assert plan["parameters"]["k"]["sd_after"] < plan["parameters"]["k"]["sd_before"]
    assert plan["parameters"]["k"]["unit"] == found["parameters"]["k"]["unit"]
    page = (out / "report.html").read_text("utf-8")
    assert 'id="design"' in page
    assert "next_experiment.csv" in page


@pytest.mark.parametrize("travel", ["position", "position=far"])
def test_travel_that_is_no_number(travel: str) -> None:
    done = CliRunner().invoke(main, ["design", "--travel", travel, "--data", "train.csv"])
    assert done.exit_code == 2
    assert "y=0.5" in done.stderr
