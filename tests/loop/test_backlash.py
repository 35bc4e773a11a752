"""Play in series with a spring and a damper, found by the loop on recordings of a simulator of its own."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import damped_stops, held

from aero_bayes.data import Recording
from aero_bayes.loop import LoopSettings, close_loop

DRIVE = """model Drive "A motor drives a load through a gear"
  parameter Real J_l(unit = "kg.m2", min = 0) = 0.08;
  parameter Real c(unit = "N.m/rad", min = 0) = 60;
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.4;
  parameter Real D(unit = "N.m.s/rad", min = 0) = 0.2;
  input Real tau(unit = "N.m");
  output Real w_m(unit = "rad/s", start = 0, fixed = true);
  output Real w_l(unit = "rad/s", start = 0, fixed = true);
  Real phi(unit = "rad", start = 0, fixed = true);
equation
  der(phi) = w_m - w_l;
  0.02*der(w_m) = tau - c*phi - d*(w_m - w_l);
  J_l*der(w_l) = c*phi + d*(w_m - w_l) - D*w_l;
end Drive;
"""
STIFFNESS, DAMPER, PLAY, NOISE = 80.0, 0.3, 0.05, 0.05


def drive(name, seed):
    """The gear carries nothing within the play and only ever pushes; the torque is held."""
    rng = np.random.default_rng(seed)
    torque = np.repeat(rng.uniform(-4.0, 4.0, 60), 20)

    def slope(x, tau):
        w_m, w_l, phi = x
        carried = damped_stops(phi, w_m - w_l, STIFFNESS, PLAY, DAMPER / STIFFNESS)
        return np.array([(tau - carried) / 0.02, (carried - 0.15 * w_l) / 0.1, w_m - w_l])

    speeds = held(slope, np.zeros(3), torque, 0.01, 20)[:, :2] + rng.normal(0.0, NOISE, (torque.size, 2))
    return Recording(name, 0.01 * np.arange(torque.size), {"tau": torque}, {"w_m": speeds[:, 0], "w_l": speeds[:, 1]})


@pytest.mark.long
def test_play_takes_the_damper_out_of_action_too(tmp_path):
    source = tmp_path / "Drive.mo"
    source.write_text(DRIVE, encoding="utf-8")
    laws = ("backlash", "end_stop", "coulomb_friction", "cubic_stiffness", "hysteretic_spring")
    settings = LoopSettings(
        max_effects=2, parameters=("J_l", "c", "d", "D"), laws=laws,
    )  # fmt: skip
    test = drive("b", 42)
    result = close_loop([drive("a", 41)], [test], model=source, settings=settings, workers=0)
    (effect,) = result.effects
    assert effect.id.startswith("backlash@")
    stiffness, half, damping = (p.value for p in effect.parameters)
    assert stiffness == pytest.approx(STIFFNESS, rel=0.05)
    assert half == pytest.approx(PLAY, rel=0.03)
    assert stiffness * damping == pytest.approx(DAMPER, rel=0.2)
    assert result.predicted_after.pooled("test")["w_l"] < 1.5 * NOISE
    assert result.predicted_before.pooled("test")["w_l"] > 3.0 * NOISE
    # Both fits still simulate: their FMUs are there as long as the result.
    for fit, told in ((result.before, result.predicted_before), (result.after, result.predicted_after)):
        left = test.outputs["w_l"] - told.fitted["b", "w_l"]
        assert fit.predict(test).rms["w_l"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-3)
