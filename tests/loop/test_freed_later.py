"""Parameters that the model as it stands cannot tell apart, and that an effect lets the data tell."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import held

from aero_bayes.data import Recording
from aero_bayes.estimate import ParameterSpec
from aero_bayes.loop import LoopSettings, close_loop

LADDER = """model Ladder "Two filters of a resistor and a capacitor each; only their time constants show"
  parameter Real R_1(unit = "Ohm", min = 0) = 1;
  parameter Real R_2(unit = "Ohm", min = 0) = 2;
  parameter Real C_1(unit = "F", min = 0) = 1;
  parameter Real C_2(unit = "F", min = 0) = 1.7;
  input Real u(unit = "V");
  output Real y(unit = "V", start = 0, fixed = true);
  Real v(unit = "V", start = 0, fixed = true);
equation
  C_1*der(v) = (u - v)/R_1 - (v - y)/R_2;
  C_2*der(y) = (v - y)/R_2;
end Ladder;
"""
R_1, R_2, C_1, C_2, LEAK, SD = 1.1, 1.8, 1.0, 1.4, 0.2, 0.002


def driven(name: str, seed: int) -> Recording:
    """The ladder with a leak at its end that grows by the square: fourth-order Runge-Kutta."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-3.0, 3.0, 60), 12)

    def slope(x, u):
        between = (x[0] - x[1]) / R_2
        return np.array([((u - x[0]) / R_1 - between) / C_1, (between - LEAK * x[1] * abs(x[1])) / C_2])

    read = held(slope, np.zeros(2), u, 0.25, 8)[:, 1]
    return Recording(name, 0.25 * np.arange(u.size), {"u": u}, {"y": read + SD * rng.normal(size=u.size)})


#: Resistances are fitted; capacitances are fixed until an effect is added with which the data determine them.
LATER = {"R_1": None, "R_2": None} | dict.fromkeys(("C_1", "C_2"), ParameterSpec(free_if_identified=True))


@pytest.fixture
def ladder(tmp_path):
    path = tmp_path / "Ladder.mo"
    path.write_text(LADDER, encoding="utf-8")
    return path


@pytest.fixture
def settings(tmp_path):
    return LoopSettings(
        max_effects=2, parameters=LATER,
        laws=("square_loss", "linear_loss", "lag", "gain"), cache=tmp_path / "fmu",
    )  # fmt: skip


def test_a_wrong_fixed_value_is_freed_beside_the_effect(ladder, settings):
    result = close_loop([driven("a", 61)], [driven("b", 62)], model=ladder, settings=settings, workers=0)
    freed = [effect.id for effect in result.effects if effect.id.startswith("value@")]
    assert [effect.id for effect in result.effects if effect.id not in freed] == ["square_loss@y"]
    assert len(freed) == 1
    assert result.predicted_after.pooled("test")["y"] < 1.1 * SD
    # the scale of all impedances stays open: what is known are products
    value = {name: estimate.value for name, estimate in result.parameters.items()}
    held = {"C_1": 1.0, "C_2": 1.7}
    assert len(held.keys() & value.keys()) == 1
    c_1, c_2 = (value.get(name, held[name]) for name in ("C_1", "C_2"))
    leak = next(e for e in result.effects if e.id not in freed).parameters[0].value
    assert c_2 / c_1 == pytest.approx(C_2 / C_1, rel=0.02)
    assert value["R_1"] * c_1 == pytest.approx(R_1 * C_1, rel=0.02)
    assert value["R_2"] * c_1 == pytest.approx(R_2 * C_1, rel=0.02)
    assert leak * value["R_1"] == pytest.approx(LEAK * R_1, rel=0.02)
