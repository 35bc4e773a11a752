"""Intervals are as wide as what the rounding of a corner leaves open: dry friction, simulated with exact sticking."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording

pytestmark = pytest.mark.fast

MASS, DAMPING, FRICTION, STIFFNESS, SD = 1.5, 2.0, 0.5, 60.0, 3e-5
CART = """model Cart
  parameter Real m(unit = "kg", min = 0.1, max = 10) = 1.2;
  parameter Real d(unit = "N.s/m", min = 0, max = 20) = 1.0;
  parameter Real F_c(unit = "N", min = 0, max = 5) = 0.3;
  WIDTH = 2e-5 "Speed over which friction changes its sign";
  input Real F(unit = "N");
  output Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  m * der(v) = F - 60 * x - d * v - F_c * tanh(v / NAME);
end Cart;
"""


def pushed() -> Recording:
    """A cart on a spring under steps of force: by closed form between the instants at which it stops or turns."""
    step, fine = 0.005, 20
    time = np.arange(0.0, 12.0, step)
    force = np.repeat([0.0, 5.0, -3.0, 4.0, 0.5, -5.0], 400)
    x, v, found = 0.0, 0.0, []
    for f in force:
        found.append(x)
        left = step
        while left > 1e-12:
            pull = f - STIFFNESS * x
            if v == 0.0 and abs(pull) <= FRICTION:
                break  # it sticks until the force changes
            sign = np.sign(v) if v != 0.0 else np.sign(pull)
            ahead = _slide(x, v, f - sign * FRICTION, np.linspace(0.0, left, fine)[1:])
            turned = np.flatnonzero(np.sign(ahead[1]) != sign)
            if not turned.size:
                x, v = ahead[0][-1], ahead[1][-1]
                break
            low, high = (turned[0]) * left / (fine - 1), (turned[0] + 1) * left / (fine - 1)
            for _ in range(60):
                middle = 0.5 * (low + high)
                low, high = (
                    (middle, high) if np.sign(_slide(x, v, f - sign * FRICTION, middle)[1]) == sign else (low, middle)
                )
            x, v, left = float(_slide(x, v, f - sign * FRICTION, high)[0]), 0.0, left - high
    readings = np.array(found) + SD * np.random.default_rng(3).standard_normal(time.size)
    return Recording("pushed", time, {"F": force}, {"x": readings}, {"time": "s", "F": "N", "x": "m"})


def _slide(x: float, v: float, force: float, t: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Position and speed after ``t`` under a constant force."""
    rest, a = force / STIFFNESS, DAMPING / (2.0 * MASS)
    w = np.sqrt(STIFFNESS / MASS - a**2)
    first, second = x - rest, (v + a * (x - rest)) / w
    decay, cos, sin = np.exp(-a * np.asarray(t)), np.cos(w * np.asarray(t)), np.sin(w * np.asarray(t))
    there = decay * (first * cos + second * sin)
    return rest + there, decay * w * (second * cos - first * sin) - a * there


@pytest.mark.parametrize("declared", ["parameter Real v_smooth", "constant Real v_smooth", "constant Real v_c"])
def test_the_truth_lies_in_intervals_that_know_of_the_rounding(declared: str, tmp_path: Path) -> None:
    path = tmp_path / "Cart.mo"
    path.write_text(CART.replace("WIDTH", declared).replace("NAME", declared.split()[-1]))
    settings = aero_bayes.FitSettings(method="local")
    found = aero_bayes.fit(
        pushed(), aero_bayes.load_model(path), parameters=["m", "d", "F_c"], settings=settings, workers=0
    )
    truth = {"m": MASS, "d": DAMPING, "F_c": FRICTION}
    inside = {name: found[name].q05 < value < found[name].q95 for name, value in truth.items()}
    if declared.endswith("v_c"):  # a width by another name is a value of the law
        assert not found.rounding_shift
        assert not all(inside.values())
        return
    assert all(inside.values())
    assert max(found.rounding_shift.values()) > 1.0
    assert "rounding" in found["d"].note
    for name in ("d", "F_c"):
        assert found[name].q95 - found[name].q05 < 4.0 * abs(found[name].value - truth[name])


def test_a_lag_that_is_kept_above_a_least_one_has_an_interval_that_knows(tmp_path: Path) -> None:
    """The fitted lag is off by a closed form: ``(T^4 - T_min^4)^(1/4)`` where the truth is ``T``."""
    (tmp_path / "Late.mo").write_text(
        """model Late
  parameter Real T(unit = "s", min = 0.01, max = 1) = 0.2;
  constant Real T_min = 0.06;
  input Real u;
  output Real y(start = 0, fixed = true);
equation
  (T ^ 4 + T_min ^ 4) ^ 0.25 * der(y) = u - y;
end Late;
"""
    )
    time = np.arange(0.0, 2.0, 0.01)
    readings = 1.0 - np.exp(-time / 0.1) + 1e-4 * np.random.default_rng(5).standard_normal(time.size)
    recording = Recording("step", time, {"u": np.ones(time.size)}, {"y": readings}, {"time": "s"})
    model = aero_bayes.load_model(tmp_path / "Late.mo")
    lag = aero_bayes.fit(
        recording, model, parameters=["T"], settings=aero_bayes.FitSettings(method="local"), workers=0
    )["T"]
    off = 0.1 - (0.1**4 - 0.06**4) ** 0.25
    assert lag.value == pytest.approx(0.1 - off, abs=1e-4)
    assert lag.q05 < 0.1 < lag.q95
    assert lag.q95 - lag.q05 < 8.0 * off
