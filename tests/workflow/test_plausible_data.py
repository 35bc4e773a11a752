"""What can be told before a fit: an input that nobody drives, degrees Celsius; ``check`` tells it as ``fit`` does."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import vessel
from click.testing import CliRunner, Result
from facts import facts

from aero_bayes.cli import main

pytestmark = pytest.mark.fast

ROOM = """
model Room
  parameter Real C(unit = "J/K", min = 0) = 2e6;
  parameter Real G(unit = "W/K", min = 0) = 80;
  input Real P(unit = "kW");
  input Real T_amb(unit = "K");
  output Real T(unit = "K") = x;
  Real x(unit = "K", start = 278, fixed = true);
equation
  C * der(x) = 1000 * P + G * (T_amb - x);
end Room;
"""
CONFIG = """
[model]
sources = ["Room.mo"]
name = "Room"
[data]
inputs = ["P"]
constants = {T_amb = 278.0}
[parameters]
C = {free = true}
G = {free = true}
[fit]
method = "local"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A heated room, recorded in K."""
    (tmp_path / "Room.mo").write_text(ROOM)
    (tmp_path / "room.toml").write_text(CONFIG)
    vessel.record(tmp_path / "run.csv", "time,P,T", gain=1000.0 / 1.5e6, k=100.0 / 1.5e6, step=60.0, zero=278.0)
    return tmp_path


def run(folder: Path, command: str, *more: str | Path) -> Result:
    options = ["--config", folder / "room.toml", "--data", folder / "run.csv", *more]
    return CliRunner().invoke(main, [command, *map(str, options)])


def test_a_constant_stands_for_an_input_without_a_column(folder: Path):
    done = run(folder, "fit", "--out", folder / "out", "--quiet", "--workers", "1")
    assert done.exit_code == 0, done.output
    found = json.loads((folder / "out" / "result.json").read_text("utf-8"))["parameters"]
    for name, truth in (("C", 1.5e6), ("G", 100.0)):
        assert found[name]["value"] == pytest.approx(truth, rel=0.005)


@pytest.mark.parametrize("rise", [0.0, 300.0])
def test_degrees_celsius_are_told_from_kelvin(folder: Path, rise: float):
    table = np.loadtxt(folder / "run.csv", delimiter=",", skiprows=1)
    table[:, 2] += np.linspace(0.0, rise, 400) - 273.15
    np.savetxt(folder / "run.csv", table, delimiter=",", header="time,P,T", comments="")
    done = run(folder, "fit", "--out", folder / "out")
    assert done.exit_code == 2
    assert re.search(facts("run.csv", "column T", "[data.columns.T]", "degC"), done.stderr)
    checked = run(folder, "check")
    assert (checked.exit_code, checked.stderr) == (2, done.stderr)
    if not rise:
        (folder / "room.toml").write_text(f'{CONFIG}[data.columns.T]\nsource = "T"\nunit = "degC"\n')
        checked = run(folder, "check")
        assert checked.exit_code == 0, checked.output
        assert re.search(r"T: 27[78][\d.]* to \d+[\d.]* K", checked.output)
