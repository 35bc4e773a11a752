"""A start that the model fixes and the recordings contradict is named before any law."""

from dataclasses import replace

import numpy as np
import pytest
from closed_form import held

from aero_bayes import FitSettings, fit
from aero_bayes.data import Recording
from aero_bayes.estimate.initial_states import held_start
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.simulation.engines import open_simulator

ROOM = """model Room
  parameter Real C_a(unit = "J/K", min = 0) = 8e5;
  parameter Real C_w(unit = "J/K", min = 0) = 8e6;
  parameter Real R_a(unit = "K/W", min = 0) = 0.005;
  input Real Q(unit = "W");
  output Real T(unit = "K", start = 0, fixed = true);
  Real T_w(unit = "K", start = 0, fixed = true);
equation
  C_a*der(T) = Q - (T - T_w)/R_a;
  C_w*der(T_w) = (T - T_w)/R_a - T_w/0.012;
end Room;
"""


def heated(name: str, seed: int, wall: float) -> Recording:
    """Above the outside: air at 0, and a wall that is warmer by ``wall`` K; fourth-order Runge-Kutta."""
    heat = np.repeat(np.random.default_rng(seed).uniform(0.0, 2000.0, 40), 10)

    def slope(x, q):
        through = (x[0] - x[1]) / 0.004
        return np.array([(q - through) / 1e6, (through - x[1] / 0.012) / 1e7])

    read = held(slope, np.array([0.0, wall]), heat, 120.0, 8)[:, 0]
    noise = 0.02 * np.random.default_rng(seed + 1000).normal(size=heat.size)
    return Recording(name, 120.0 * np.arange(heat.size), {"Q": heat}, {"T": read + noise})


def test_a_wall_that_starts_warmer_than_the_model_says_is_no_law(tmp_path):
    (tmp_path / "Room.mo").write_text(ROOM, encoding="utf-8")
    settings = LoopSettings(
        parameters=("C_a", "C_w", "R_a"), effects=("start@T_w", "offset", "gain", "linear_loss"),
        cache=tmp_path / "fmu", max_effects=2,
    )  # fmt: skip
    result = close_loop(
        [heated("a", 11, 2.0)], [heated("b", 12, 1.0)], model=tmp_path / "Room.mo", settings=settings, workers=0
    )
    assert [effect.id for effect in result.effects] == ["start@T_w"]
    (start,) = result.effects[0].parameters
    assert start.value == pytest.approx(2.0, abs=0.05)
    assert start.q05 < 2.0 < start.q95
    assert result.parameters["C_w"].value == pytest.approx(1e7, rel=0.03)
    # the other day's own start is estimated from its validation half
    assert result.predicted_after.pooled("test")["T"] < 1.2 * 0.02


def test_a_start_is_that_of_its_state_where_a_law_acts_on_the_reading(tmp_path):
    (tmp_path / "Room.mo").write_text(ROOM, encoding="utf-8")
    family = ModelicaFamily(LawPlaces("Room", (tmp_path / "Room.mo",)), tmp_path / "fmu")
    base = family.base_model()
    found = fit([heated("a", 11, 2.0)], base, parameters=["C_a"], settings=FitSettings("local"), workers=0)
    family.prepare(found.calibration, found.optimum, open_simulator)
    air, wall = (held_start(base, s, 1.0, "", 0) for s in sorted(base.states, key=lambda s: s.name))
    lagging = family.with_candidates(["lag@output_T"]).model
    moved, same = family.starts_on([replace(air, starts=("T",)), wall], base, lagging)
    names = {state.name for state in lagging.states}
    assert {moved.target.state, *moved.starts, same.target.state} <= names
    assert moved.target.state == moved.starts[0] == "T_unread"
    assert same == wall


def test_the_written_model_has_the_fitted_values_and_the_start_in_its_difference(tmp_path):
    (tmp_path / "Room.mo").write_text(ROOM, encoding="utf-8")
    family = ModelicaFamily(LawPlaces("Room", (tmp_path / "Room.mo",)), tmp_path / "fmu")
    found = fit(
        [heated("a", 11, 2.0)], family.base_model(), parameters=["C_a"], settings=FitSettings("local"), workers=0
    )
    family.prepare(found.calibration, found.optimum, open_simulator)
    extended = family.extend(["lag@Q"], {}, tmp_path / "out")
    name = next(new for pairs in extended.names.values() for _, new in pairs if "start" not in new)
    written = extended.with_values({name: 125.0}, {"T_w": 2.0})
    added = [line for line in written.diff.splitlines() if line.startswith("+")]
    assert written.path.read_text(encoding="utf-8") == written.text
    assert any(f" {name}(" in line and "= 125.0 " in line for line in added)
    assert any("T_w(" in line and "start = 2.0" in line for line in added)


DRIVE = """model Drive
  parameter Real T(unit = "s", min = 0) = 1;
  parameter Real K(min = 0) = 1;
  input Real u(unit = "V");
  output Real y(unit = "V", start = 0, fixed = true);
equation
  T*der(y) = K*u - y;
end Drive;
"""


def late(name: str, seed: int, start: float) -> Recording:
    """Behind a filter of 0.4 s, which holds something else than the first input when a recording begins."""
    u = np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, 20), 20)

    def slope(x, level):
        return np.array([(level - x[0]) / 0.4, (1.5 * x[0] - x[1]) / 0.8])

    read = held(slope, np.array([start, 0.0]), u, 0.05, 8)[:, 1]
    return Recording(
        name, 0.05 * np.arange(u.size), {"u": u},
        {"y": read + 0.003 * np.random.default_rng(seed + 1000).normal(size=u.size)},
    )  # fmt: skip


def test_the_start_of_a_laws_state_has_a_value_in_each_recording(tmp_path):
    (tmp_path / "Drive.mo").write_text(DRIVE, encoding="utf-8")
    settings = LoopSettings(parameters=("T", "K"), laws=("lag", "gain", "offset"), max_effects=1)
    training = [late("a", 21, 2.0), late("b", 22, -1.5)]
    result = close_loop(training, [late("c", 23, 1.0)], model=tmp_path / "Drive.mo", settings=settings, workers=0)
    assert [effect.id for effect in result.effects] == ["lag@u"]
    (time,) = (p for p in result.effects[0].parameters if p.name == "T_l")
    # the two time constants in series may be exchanged
    assert time.value == pytest.approx(0.4, rel=0.05) or time.value == pytest.approx(0.8, rel=0.05)
    assert 'T_l(unit = "s"' in result.modelica
    written = float(result.modelica.partition("T_l(")[2].partition(") = ")[2].partition(" ")[0])
    assert written == pytest.approx(time.value, rel=1e-5)
