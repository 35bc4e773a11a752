"""A gear whose dry friction grows with the torque that it passes on."""

from __future__ import annotations

import numpy as np

from aero_bayes.data import Recording
from aero_bayes.loop import LoopResult, LoopSettings, close_loop
from aero_bayes.loop.search import Effort

LAWS = ("coulomb_friction", "load_friction", "viscous_friction", "quadratic_drag", "gain", "curve")
GEARED = """model Geared "A motor with a gear"
  parameter Real J(unit = "kg.m2", min = 0) = 2e-3;
  parameter Real d(unit = "N.m.s/rad", min = 0) = 4e-3;
  input Real tau(unit = "N.m");
  output Real w(unit = "rad/s", start = 0, fixed = true);
equation
  J*der(w) = tau - d*w;
end Geared;
"""


def turned(name: str, seed: int) -> Recording:
    """Set-valued friction of 0.02 N.m and 0.3 of the load, stepped in time by impulses (Moreau), with noise."""
    rng = np.random.default_rng(seed)
    tau = np.repeat(rng.uniform(-0.5, 0.5, 60), 25)
    step, speed, found = 0.01 / 50, 0.0, []
    for torque in tau:
        found.append(speed)
        for _ in range(50):
            load = torque - 5e-3 * speed
            free, most = speed + step / 1.5e-3 * load, step / 1.5e-3 * (0.02 + 0.3 * abs(load))
            speed = np.sign(free) * max(abs(free) - most, 0.0)
    return Recording(name, 0.01 * np.arange(tau.size), {"tau": tau}, {"w": found + 0.2 * rng.normal(size=tau.size)})


def found_from(source) -> LoopResult:
    settings = LoopSettings(laws=LAWS, parameters=("J", "d"))
    return close_loop([turned("first", 1)], [turned("second", 2)], model=source, workers=0, settings=settings)


def test_friction_that_grows_with_the_load_is_told_from_a_constant_one(modelica):
    loop = found_from(modelica(GEARED))
    assert [e.id for e in loop.effects] == ["load_friction@w"]
    assert loop.effects[0].claim == "law"
    assert loop.effects[0].tried_all
    known = {p.name: p for p in loop.effects[0].parameters}
    for name, truth in (("L", 0.3), ("f_0", 0.02 / 0.3)):
        assert known[name].q05 - 0.02 * truth <= truth <= known[name].q95 + 0.02 * truth
    assert loop.predicted_after.pooled("test")["w"] < 0.25


def test_where_the_effort_ends_before_all_was_tried_in_its_place_no_law_is_claimed(modelica, monkeypatch):
    monkeypatch.setattr(Effort, "of", lambda steps: Effort(fitted=(1, 6), swaps=0))
    loop = found_from(modelica(GEARED))
    assert loop.effects[0].claim == "place"
    assert not loop.effects[0].tried_all
