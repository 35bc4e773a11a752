"""Rigs whose first fit says little: what starts hot, what grows, what moves when the recording begins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from closed_form import held

from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.loop import LoopResult, LoopSettings, close_loop

CULTURE = """model Culture "A culture that is fed"
  parameter Real r(unit = "1/s", min = 0) = 1.2e-4;
  parameter Real y(min = 0) = 1;
  input Real feed(unit = "kg/(m3.s)");
  output Real x(unit = "kg/m3", start = 0.5, fixed = true, min = 0);
equation
  der(x) = r*x + y*feed;
end Culture;
"""
BODY = """model Body "A heated body that loses heat to the room"
  parameter Real C(unit = "J/K", min = 0) = 300;
  parameter Real G(unit = "W/K", min = 0) = 1;
  input Real P(unit = "W");
  output Real T_read(unit = "degC");
protected
  Real T(unit = "K", start = 550, fixed = true);
equation
  C*der(T) = P - G*(T - 293.15);
  T_read = T - 273.15;
end Body;
"""
CART = """model Cart "A cart in a fluid"
  parameter Real m(unit = "kg", min = 0) = 1.5;
  parameter Real c(unit = "N.s/m", min = 0) = 0.5;
  input Real F(unit = "N");
  output Real v(unit = "m/s", start = 0, fixed = true);
equation
  m*der(v) = F - c*v;
end Cart;
"""
#: Stefan's constant times an area of 0.045 m2.
RADIATED = 5.67e-8 * 0.045


def culture(name: str, seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    feed = np.repeat(rng.choice([0.0, 0.5e-4, 1e-4], 6), 20)
    x = held(lambda x, u: 2e-4 * x + u - 1e-5 * x**2, rng.uniform(0.3, 1.0), feed, 900.0, 20)
    return Recording(name, 900.0 * np.arange(120), {"feed": feed}, {"x": x + rng.normal(0.0, 0.1, 120)})


def body(name: str, seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    heat = np.repeat(rng.choice([0.0, 150.0, 300.0], 8), 50)
    temperature = held(
        lambda x, u: (u - 0.4 * (x - 293.15) - RADIATED * (x**4 - 293.15**4)) / 250.0,
        rng.uniform(500.0, 600.0), heat, 10.0, 20,
    )  # fmt: skip
    read = temperature - 273.15 + rng.normal(0.0, 0.5, 400)
    return Recording(name, 10.0 * np.arange(400), {"P": heat}, {"T_read": read})


def cart(name: str, seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.normal(0.0, 3.0, 30), 10)
    v = held(lambda x, u: u - x - 0.8 * x * abs(x), rng.normal(), force, 0.05, 20)
    return Recording(name, 0.05 * np.arange(300), {"F": force}, {"v": v + rng.normal(0.0, 0.005, 300)})


def close(
    source: str, free: tuple[str, ...], laws: tuple[str, ...], drawn: Callable[..., Recording], tmp_path, start="auto"
):
    (tmp_path / "Rig.mo").write_text(source, encoding="utf-8")
    settings = LoopSettings(
        parameters=free, laws=laws, cache=tmp_path / "fmu",
        fit=FitSettings(method="local", calibration=CalibrationSettings(initial_states=start)),
    )  # fmt: skip
    return close_loop(
        [drawn("train", 41)],
        [drawn("test", 42)],
        model=tmp_path / "Rig.mo",
        settings=settings,
        workers=0,
    )


def unseen(result: LoopResult) -> tuple[float, float]:
    ((before,), (after,)) = (role.pooled("test").values() for role in (result.predicted_before, result.predicted_after))
    return before, after


def test_what_a_first_fit_put_out_of_action_is_called_back(tmp_path):
    """Without what ends the growth a culture does best without any growth: a rate near zero has no slope."""
    result = close(
        CULTURE, ("r", "y"), ("square_loss", "overflow", "saturation", "offset"), culture, tmp_path, "estimated"
    )
    assert [effect.id for effect in result.effects] == ["square_loss@x"]
    before, after = unseen(result)
    assert before > 20.0 * 0.1
    assert after < 1.3 * 0.1
    assert result.parameters["r"].value == pytest.approx(2e-4, rel=0.03)
    assert result.effects[0].parameters[0].value == pytest.approx(1e-5, rel=0.03)


def test_a_body_that_starts_hot_radiates_to_the_room_that_its_model_knows(tmp_path):
    result = close(BODY, ("C", "G"), ("radiation", "gain", "offset", "square_loss"), body, tmp_path, "estimated")
    assert [effect.id for effect in result.effects] == ["radiation@T"]
    assert unseen(result)[1] < 1.2 * 0.5
    assert result.effects[0].parameters[0].value == pytest.approx(RADIATED, rel=0.05)
    assert result.parameters["C"].value == pytest.approx(250.0, rel=0.03)


def test_a_recording_in_motion_is_predicted_from_where_it_begins(tmp_path):
    result = close(CART, ("m", "c"), ("quadratic_drag", "coulomb_friction", "saturation"), cart, tmp_path)
    assert [effect.id for effect in result.effects] == ["quadratic_drag@v"]
    assert unseen(result)[1] < 1.5 * 0.005
