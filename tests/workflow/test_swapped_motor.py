"""A motor fitted to steps and tested on a chirp: each recording is judged by itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import swapped_motor
from click.testing import CliRunner

from aero_bayes.cli import main


def test_the_verdict_names_the_test_recording_that_is_not_predicted_down_to_its_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swapped_motor.write(tmp_path)
    told = (tmp_path / "rig.toml").read_text("utf-8").replace("inputs =", 'interpolation = "hold"\ninputs =')
    # whether friction is clear beside inputs read wrongly hangs on rounding; the verdict on either recording does not
    told = told.replace("[loop]", '[loop]\nrequire = ["coulomb_friction@speed"]')
    (tmp_path / "hold.toml").write_text(told, "utf-8")
    monkeypatch.chdir(tmp_path)
    typed = "close-loop --config hold.toml --train steps.csv --test chirp.csv --out out --workers 1 --quiet"
    done = CliRunner().invoke(main, typed.split())
    assert done.exit_code == 0, done.output
    result = json.loads(Path("out", "result.json").read_text("utf-8"))
    assert result["verdict"]["level"] == "warning"
    assert "test part of chirp" in result["verdict"]["text"]
    assert "steps" not in result["verdict"]["text"]
    far = {(e["recording"], e["output"]) for e in result["loop"]["errors"] if e["verdict"] == "too large"}
    assert far == {("chirp", "i"), ("chirp", "w")}
    assert "more than 1.3 times the noise" in Path("out", "report.html").read_text("utf-8")
