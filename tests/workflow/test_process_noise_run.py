"""A run with process noise, from the TOML file to the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from aero_bayes.cli import main

RIG = """model Tank
  parameter Real k(unit = "1/s") = 0.5; input Real u(unit = "1"); output Real h(unit = "m", start = 1, fixed = true);
equation
  der(h) = u - k * h;
end Tank;
"""
CONFIG = """
[model]
sources = ["Tank.mo"]
name = "Tank"
[data]
inputs = ["u"]
outputs = ["h"]
[parameters]
k = {free = true}
[fit]
method = "local"
[noise.process]
h = "estimated"
"""


def recorded(tmp_path: Path, config: str) -> np.ndarray:
    """Write a rig and a recording of it to a folder; the true level."""
    rng, time = np.random.default_rng(8), np.arange(200) * 0.1
    u, level, levels = np.sign(np.sin(time)) + 1.0, 1.0, []
    for k in range(time.size):
        levels.append(level)
        level += 0.1 * (u[k] - 0.5 * level) + 0.3 * np.sqrt(0.1) * rng.standard_normal()
    (tmp_path / "Tank.mo").write_text(RIG)
    (tmp_path / "rig.toml").write_text(config)
    table = np.column_stack([time, u, np.array(levels) + 0.02 * rng.standard_normal(time.size)])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="time,u,h", comments="")
    return np.array(levels)


def test_diffusion_and_smoothed_states_reach_result_and_page(tmp_path: Path):
    levels = recorded(tmp_path, CONFIG)
    options = ["--config", tmp_path / "rig.toml", "--data", tmp_path / "run.csv", "--out", tmp_path / "out", "--quiet"]
    done = CliRunner().invoke(main, ["fit", *map(str, options)])
    assert done.exit_code == 0, done.output

    result = json.loads((tmp_path / "out" / "result.json").read_text())
    found = result["process_noise"]["h"]
    assert found == result["parameters"]["process.h"]
    assert found["unit"] == "m/sqrt(s)"
    assert abs(found["value"] - 0.3) < 4.0 * found["sd"]
    assert result["residual"]["run"]["h"]["verdict"] == "adequate"
    series = np.load(tmp_path / "out" / "series.npz")
    smoothed, low, high = (series[f"{group}/run/h"] for group in ("smoothed", "smoothed_lower", "smoothed_upper"))
    assert np.sqrt(np.mean((smoothed - levels) ** 2)) < 0.03
    assert np.all(low <= high)
    assert 0.75 < np.mean((low <= levels) & (levels <= high)) <= 1.0
    assert (tmp_path / "out" / "report.html").is_file()
