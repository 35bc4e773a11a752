"""The size from which ``ports`` says that a law would be named is right by a factor of two: loops tell."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from aero_bayes import LoopSettings, close_loop
from aero_bayes.cli import main
from aero_bayes.data import Recording, write_csv

ROOM = """model Room
  parameter Real C(unit = "J/K", min = 1e5, max = 1e7) = 8e5;
  parameter Real G(unit = "W/K", min = 10, max = 1000) = 80;
  input Real Q(unit = "W");
  output Real T(unit = "K", start = 0, fixed = true);
equation
  C * der(T) = Q - G * T;
end Room;
"""
CONFIG = """[model]
sources = ["Room.mo"]
name = "Room"
[parameters]
C = {free = true}
G = {free = true}
"""


def heated(lag: float, seed: int) -> Recording:
    """A room of 1e6 J/K and 100 W/K whose heater follows its input with a lag, by closed form, and noise of 0.1 K."""
    rng, step, rate = np.random.default_rng(seed), 60.0, 1e-4
    power = np.repeat(rng.uniform(0.0, 2000.0, 30), 40)
    there, heat, found = 0.0, power[0], []
    for q in power:
        found.append(there)
        rest, over = q / 100.0, heat - q
        faded, slow = np.exp(-step / lag) if lag else 0.0, np.exp(-step * rate)
        part = over / 1e6 * (slow - faded) / (1.0 / lag - rate) if lag else 0.0
        there, heat = rest + (there - rest) * slow + part, q + over * faded
    readings = np.array(found) + 0.1 * rng.standard_normal(power.size)
    units = {"time": "s", "Q": "W", "T": "K"}
    return Recording(f"r{seed}", step * np.arange(power.size), {"Q": power}, {"T": readings}, units)


def test_the_size_that_would_be_named_is_right_by_a_factor_of_two(tmp_path: Path) -> None:
    (tmp_path / "Room.mo").write_text(ROOM)
    (tmp_path / "rig.toml").write_text(CONFIG)
    write_csv(heated(0.0, 1), tmp_path / "run.csv")
    given = ["ports", "--config", str(tmp_path / "rig.toml"), "--data", str(tmp_path / "run.csv"), "--json"]
    rows = json.loads(CliRunner().invoke(main, given, catch_exceptions=False).stdout)
    limits = {(one["law"], row["id"]): one["smallest"] for row in rows for one in row["limits"]}
    smallest = limits["lag", "Q"]
    settings = LoopSettings(
        parameters=("C", "G"), laws=("lag", "offset", "gain", "square_law", "linear_loss"), cache=tmp_path / "fmu"
    )
    for share in (0.5, 2.0):
        train, test = heated(share * smallest, 2), heated(share * smallest, 3)
        found = close_loop([train], [test], model=tmp_path / "Room.mo", settings=settings, workers=0)
        # of a linear model a lag of the input is one of the output
        named = {term for effect in found.effects for term in (effect.id, *(one.id for one in effect.alternatives))}
        assert ("lag@Q" in named) == (share > 1.0)
        assert len(found.effects) == (share > 1.0)
