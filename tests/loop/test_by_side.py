"""What differs by side, found by the loop on recordings of a simulator of its own."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import damped_stops, held

from aero_bayes.data import Recording
from aero_bayes.loop import LoopSettings, close_loop

TRACK = """model Track "A cart, its position from the left end of its track"
  parameter Real m(unit = "kg", min = 0) = 0.8;
  parameter Real d(unit = "N.s/m", min = 0) = 1.5;
  input Real F(unit = "N");
  output Real x(unit = "m", start = 0.3, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  m*der(v) = F - d*v;
end Track;
"""
LEFT, RIGHT, BLUR = 0.02, 0.6, 5e-4

METER = """model Meter "A lag and its reading"
  parameter Real T(unit = "s", min = 0) = 1;
  parameter Real K = 2;
  input Real u(unit = "V");
  output Real y(unit = "V");
  Real x(unit = "V", start = 0, fixed = true);
equation
  T*der(x) + x = K*u;
  y = x;
end Meter;
"""
FULL, NOISE = 1.5, 0.01


def track(name, seed, damping):
    """A cart that runs into a soft stop on either side, the middle between them far from zero.

    A stop is a spring and a damper beside each other, and never pulls.
    """
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.uniform(-3.0, 3.0, 24), 30)

    def slope(x, u):
        pressed = damped_stops(x[0] - 0.5 * (LEFT + RIGHT), x[1], 300.0, 0.5 * (RIGHT - LEFT), damping / 300.0)
        return np.array([x[1], (u - 2.0 * x[1] - pressed) / 0.9])

    place = held(slope, [0.3, 0.0], force, 0.02, 40)[:, 0]
    time = 0.02 * np.arange(force.size)
    return Recording(name, time, {"F": force}, {"x": place + rng.normal(0.0, BLUR, force.size)})


def meter(name, seed):
    """A first-order lag, exact; the instrument is full at 1.5 V."""
    rng = np.random.default_rng(seed)
    u, decay = np.repeat(rng.uniform(-1.2, 1.2, 40), 20), np.exp(-0.05 / 0.8)
    x = np.zeros(u.size)
    for n in range(u.size - 1):
        x[n + 1] = decay * x[n] + (1.0 - decay) * 2.2 * u[n]
    read = np.minimum(x, FULL) + rng.normal(0.0, NOISE, u.size)
    return Recording(name, 0.05 * np.arange(u.size), {"u": u}, {"y": read})


def closed(tmp_path, text, name, free, laws, *recordings):
    source = tmp_path / f"{name}.mo"
    source.write_text(text, encoding="utf-8")
    settings = LoopSettings(max_effects=2, parameters=free, laws=laws, cache=tmp_path / "fmu")
    first, second = recordings
    return close_loop([first], [second], model=source, settings=settings, workers=0)


@pytest.mark.parametrize("damping", [0.0, pytest.param(3.0, marks=pytest.mark.long)])
def test_stops_at_both_ends_are_found_wherever_the_track_begins(tmp_path, damping):
    laws = ("end_stop", "end_stop_by_side", "coulomb_friction", "linear_stiffness", "offset")
    result = closed(tmp_path, TRACK, "Track", ("m", "d"), laws, track("a", 75, damping), track("b", 76, damping))
    (effect,) = result.effects
    assert effect.id == "end_stop_by_side@v"
    stiffness, distance, _, damper = (p.value for p in effect.parameters)
    assert stiffness == pytest.approx(300.0, rel=0.05)
    assert distance == pytest.approx((RIGHT - LEFT) / 2.0, rel=0.01)
    assert stiffness * damper == pytest.approx(damping, rel=0.05, abs=0.05)
    assert result.predicted_after.pooled("test")["x"] < 2.0 * BLUR
    assert result.predicted_before.pooled("test")["x"] > 50.0 * BLUR


def test_a_reading_that_ends_at_the_instruments_range_is_found(tmp_path):
    laws = ("saturation", "saturation_by_side", "gain", "overflow", "square_loss", "dead_zone")
    result = closed(tmp_path, METER, "Meter", ("T", "K"), laws, meter("a", 67), meter("b", 68))
    (effect,) = result.effects
    assert effect.id == "saturation_by_side@y"
    s, a = (p.value for p in effect.parameters)
    assert 1.0 / (s * (1.0 + a)) == pytest.approx(FULL, rel=0.01)
    assert result.predicted_after.pooled("test")["y"] < 1.1 * NOISE
    assert result.predicted_before.pooled("test")["y"] > 1.5 * NOISE
