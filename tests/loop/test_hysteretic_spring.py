"""A joint that yields: its spring by Bouc and Wen, told from friction, stops and a cubic spring."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import held

from aero_bayes.data import Recording
from aero_bayes.loop import LoopSettings, close_loop

MASS = """model Mass "A mass on a spring and a damper, shaken"
  parameter Real m(unit = "kg", min = 0) = 2;
  parameter Real k(unit = "N/m", min = 0) = 100;
  parameter Real c(unit = "N.s/m", min = 0) = 1;
  input Real F(unit = "N");
  output Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  m*der(v) = F - k*x - c*v;
end Mass;
"""
STEP, NOISE = 0.02, 1e-4


def shaken(name: str, seed: int) -> Recording:
    """Wen's equation with A = 90 N/m, beta = 18 /m and gamma = -22 /m in Runge-Kutta: in the law's terms k_h = 90 N/m,
    x_h = 1/18 m and s = -22/18."""
    rng = np.random.default_rng(seed)
    hertz = np.arange(0.2, 3.0, 0.05)
    time = STEP * np.arange(1200)
    waves = np.cos(2 * np.pi * hertz[:, None] * time + rng.uniform(0, 2 * np.pi, hertz.size)[:, None])
    force = 2.0 * waves.sum(axis=0)

    def slope(y, F):
        yields = 90.0 * y[1] - 18.0 * abs(y[1]) * y[2] + 22.0 * y[1] * abs(y[2])
        return np.array([y[1], (F - 90.0 * y[0] - 1.5 * y[1] - y[2]) / 2.0, yields])

    read = held(slope, np.zeros(3), force, STEP, 8)[:, 0]
    return Recording(name, time, {"F": force}, {"x": read + NOISE * rng.normal(size=time.size)})


@pytest.mark.long
def test_a_joint_that_yields_is_named_with_its_shape(tmp_path):
    (tmp_path / "Mass.mo").write_text(MASS, encoding="utf-8")
    settings = LoopSettings(
        max_effects=2, parameters=("m", "k", "c"),
        laws=("hysteretic_spring", "linear_stiffness", "cubic_stiffness", "backlash", "coulomb_friction", "lag"),
        cache=tmp_path / "fmu",
    )  # fmt: skip
    result = close_loop([shaken("a", 91)], [shaken("b", 92)], model=tmp_path / "Mass.mo", settings=settings, workers=0)
    assert [effect.id for effect in result.effects] == ["hysteretic_spring@v"]
    stiffness, width, shape = (parameter.value for parameter in result.effects[0].parameters)
    assert stiffness == pytest.approx(90.0, rel=0.02)
    assert width == pytest.approx(1 / 18, rel=0.02)
    assert shape == pytest.approx(-22 / 18, abs=0.02)
    assert result.parameters["m"].value == pytest.approx(2.0, rel=0.01)
    assert result.predicted_after.pooled("test")["x"] < 1.1 * NOISE
