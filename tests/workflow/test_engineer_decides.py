"""What the engineer decides about a loop is done and said: a required effect, a refused port."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from aero_bayes.cli import main

RIG = """model Vessel
  parameter Real k(unit = "1/s", min = 0.01, max = 10) = 0.3 "Loss";
  input Real u(unit = "kg/s");
  output Real level(unit = "kg") = a;
  Real a(unit = "kg", start = 0, fixed = true);
equation
  der(a) = u - k * a;
end Vessel;
"""
CONFIG = """[model]
sources = ["Rig.mo"]
name = "Vessel"
[parameters]
k = {free = true}
[loop]
require = ["linear_loss@a"]
exclude = ["level"]
laws = ["offset", "gain"]
"""


def test_a_required_effect_is_added_though_nothing_is_missing(tmp_path: Path):
    rng = np.random.default_rng(6)
    u, level = np.repeat(rng.uniform(0.0, 2.0, 20), 20), np.zeros(400)
    for n in range(399):
        level[n + 1] = u[n] / 0.5 + (level[n] - u[n] / 0.5) * np.exp(-0.05)
    rows = np.column_stack([np.arange(400) * 0.1, u, level + 0.01 * rng.normal(size=400)])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="time,u,level", comments="")
    (tmp_path / "Rig.mo").write_text(RIG)
    (tmp_path / "rig.toml").write_text(CONFIG)
    out = tmp_path / "out"
    arguments = ["--config", tmp_path / "rig.toml", "--train", tmp_path / "run.csv", "--out", out, "--workers", "1"]
    done = CliRunner().invoke(main, ["close-loop", *map(str, arguments), "--quiet"])
    assert done.exit_code == 0, done.output
    loop = json.loads((out / "result.json").read_text())["loop"]
    assert [effect["id"] for effect in loop["effects"]] == ["linear_loss@a"]
    tried = {c["id"] for step in loop["steps"][1:] for c in step["candidates"]}
    assert {id_.partition("@")[0] for id_ in tried} <= {"offset", "gain"}
    assert not any(id_.endswith("@level") for id_ in tried)
