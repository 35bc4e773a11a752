"""A recording in degC of a model whose output is the state: a lagging sensor and radiation, found and written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aero_bayes.cli import main

RIG = """model Oven
  parameter Real C(unit = "J/K", min = 1, max = 1000) = 30;
  parameter Real G(unit = "W/K") = 0.1;
  input Real P(unit = "W");
  output Real T(unit = "degC", start = -5, fixed = true);
equation
  C * der(T) = P - G * (T + 5);
end Oven;
"""
CONFIG = """[model]
sources = ["Rig.mo"]
name = "Oven"
[parameters]
C = {free = true}
[loop]
ports = ["output_T"]
"""
STEP, SLOW, HEAT, LOSS, SIGMA = 0.004, 20.0, 50.0, 0.1, 2e-9


@pytest.mark.long
@pytest.mark.parametrize(("required", "radiated"), [((), 0.0), (("radiation@T",), SIGMA)])
def test_a_lagging_sensor_and_radiation_are_found_and_written(
    required: tuple[str, ...], radiated: float, tmp_path: Path
) -> None:
    rng = np.random.default_rng(4)
    power = np.repeat(rng.uniform(0.0, 20.0, 12), 100)
    body = read = -5.0
    readings = []
    for p in power:
        readings.append(read)
        for _ in range(round(1.0 / STEP)):
            flow = p - LOSS * (body + 5.0) - radiated * ((body + 273.15) ** 4 - 268.15**4)
            read += STEP * (body - read) / SLOW
            body += STEP * flow / HEAT
    rows = np.column_stack([np.arange(len(power)), power, np.array(readings) + 0.05 * rng.normal(size=len(power))])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="time,P,T", comments="")
    (tmp_path / "Rig.mo").write_text(RIG)
    (tmp_path / "rig.toml").write_text(CONFIG + f"require = {json.dumps(required)}\n")
    out = tmp_path / "out"
    arguments = ["--config", tmp_path / "rig.toml", "--train", tmp_path / "run.csv", "--out", out, "--workers", "1"]
    done = CliRunner().invoke(main, ["close-loop", *map(str, arguments), "--quiet"])
    assert done.exit_code == 0, done.output
    result = json.loads((out / "result.json").read_text())
    assert set(result["fit"]["interpolation"].values()) <= {"hold", "linear"}
    assert result["fit"]["interpolation"]
    loop = result["loop"]
    found = {e["id"]: {k: p["value"] for k, p in e["parameters"].items()} for e in loop["effects"]}
    assert {*required, "lag@output_T"} <= set(found)
    assert found["lag@output_T"]["T_l"] == pytest.approx(SLOW, rel=0.1)
    if required:
        assert found["radiation@T"]["c"] == pytest.approx(SIGMA, rel=0.2)
    assert loop["after"]["test"]["T"] < 0.1
