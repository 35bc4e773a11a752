"""A run with process noise, from the TOML file to the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import vessel
from click.testing import CliRunner

from aero_bayes.cli import main

RIG = """model Tank
  parameter Real k(unit = "1/s") = 0.5; input Real u(unit = "1"); output Real h(unit = "m", start = 0, fixed = true);
equation
  der(h) = u - k * h;
end Tank;
"""
CONFIG = """
[model]
sources = ["Tank.mo"]
name = "Tank"
[parameters]
k = {free = true}
[fit]
method = "local"
[noise.process]
h = "estimated"
"""


def test_diffusion_and_smoothed_states_reach_result_and_page(tmp_path: Path):
    (tmp_path / "Tank.mo").write_text(RIG)
    (tmp_path / "rig.toml").write_text(CONFIG)
    table = np.loadtxt(vessel.record(tmp_path / "run.csv", "time,u,h"), delimiter=",", skiprows=1)
    levels = vessel.levels(table[:, 1])
    options = ["--config", tmp_path / "rig.toml", "--data", tmp_path / "run.csv", "--out", tmp_path / "out", "--quiet"]
    done = CliRunner().invoke(main, ["fit", *map(str, options)])
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["process_noise"]["h"] == result["parameters"]["process.h"]
    assert result["process_noise"]["h"]["unit"] == "m/sqrt(s)"
    series = np.load(tmp_path / "out" / "series.npz")
    smoothed, low, high = (series[f"{group}/run/h"] for group in ("smoothed", "smoothed_lower", "smoothed_upper"))
    assert np.sqrt(np.mean((smoothed - levels) ** 2)) < vessel.SD
    assert np.all(low <= smoothed)
    assert np.all(smoothed <= high)
    assert (tmp_path / "out" / "report.html").is_file()
