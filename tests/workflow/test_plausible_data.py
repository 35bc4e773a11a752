"""What can be told before a fit: an input that nobody drives, degrees Celsius, milliseconds, a long pause."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from facts import facts

from aero_bayes.cli import main

pytestmark = pytest.mark.fast

ROOM = """
model Room
  parameter Real C(unit = "J/K", min = 0) = 2e6;
  parameter Real G(unit = "W/K", min = 0) = 80;
  input Real P(unit = "W");
  input Real T_amb(unit = "K");
  output Real T(unit = "K") = x;
  Real x(unit = "K", start = 293.15, fixed = true);
equation
  C * der(x) = P + G * (T_amb - x);
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


def room(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heating on and off, and the temperature in K: its exact solution from sample to sample."""
    power = 2000.0 * (np.arange(time.size) % 80 < 40)
    temperature = np.empty(time.size)
    temperature[0] = 293.15
    for k, step in enumerate(np.diff(time)):
        settled = 278.0 + power[k] / 100.0
        temperature[k + 1] = settled + (temperature[k] - settled) * np.exp(-step * 100.0 / 1.5e6)
    return power, temperature


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "Room.mo").write_text(ROOM)
    (tmp_path / "room.toml").write_text(CONFIG)
    return tmp_path


def fit(folder: Path, time: np.ndarray, *, shift: float | np.ndarray = 0.0) -> Result:
    """Fit a recording of ``time`` in s, written with other units."""
    power, temperature = room(time)
    rng = np.random.default_rng(1)
    rows = zip(time, power, temperature + shift + 0.02 * rng.standard_normal(time.size), strict=True)
    text = "\n".join(["time,P,T", *(f"{t!r},{p!r},{y!r}" for t, p, y in rows)])
    (folder / "run.csv").write_text(text.replace("np.float64(", "").replace(")", ""))
    options = ["--config", folder / "room.toml", "--data", folder / "run.csv", "--out", folder / "out", "--quiet"]
    return CliRunner().invoke(main, ["fit", *map(str, options), "--workers", "1"])


def test_a_constant_stands_for_an_input_without_a_column(folder: Path):
    done = fit(folder, 60.0 * np.arange(400))
    assert done.exit_code == 0, done.output
    assert "G = 100" in (folder / "out" / "Room_fitted.mo").read_text("utf-8").replace("99.9", "100.")


@pytest.mark.parametrize("rise", [0.0, 300.0])
def test_degrees_celsius_are_told_from_kelvin(folder: Path, rise: float):
    done = fit(folder, 60.0 * np.arange(400), shift=-273.15 + np.linspace(0.0, rise, 400))
    assert done.exit_code == 2
    assert re.search(facts("run.csv", "column T"), done.stderr)
    assert re.search(facts("[data.columns.T]", "degC"), done.stderr)
    checked = CliRunner().invoke(main, ["check", "--config", f"{folder / 'room.toml'}", f"{folder / 'run.csv'}"])
    assert (checked.exit_code, checked.stderr) == (2, done.stderr)


def test_a_long_pause_is_said(folder: Path):
    time = 60.0 * np.arange(400)
    done = fit(folder, time + 60_000.0 * (time > 12_000.0))
    assert done.exit_code == 0, done.output
    assert re.search(facts("run.csv", "12000 s", "72060 s"), done.stderr)
