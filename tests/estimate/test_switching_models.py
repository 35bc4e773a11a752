"""Models that switch, simulated in closed form between their switchings: no interval of a fit leaves the truth out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import aero_bayes
from aero_bayes import FitSettings, Recording
from aero_bayes.simulation.model import Model

BALL = """model Ball
  parameter Real g(unit = "m/s2", min = 1, max = 30) = 9.5;
  parameter Real e(min = 0.1, max = 0.99) = 0.8;
  output Real h(unit = "m", start = 1, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(h) = v;
  der(v) = -g;
  when h < 0 then
    reinit(v, -e * pre(v));
  end when;
end Ball;
"""
RELAY = """model Relay
  parameter Real K(min = 0.5, max = 20) = 3.2;
  parameter Real T(unit = "s", min = 0.1, max = 50) = 2.1;
  output Real x(start = 0, fixed = true);
  Boolean up(start = true, fixed = true);
equation
  up = x < -1 or pre(up) and x < 1;
  T * der(x) = (if up then K else -K) - x;
end Relay;
"""
LIMITER = """model Limiter
  parameter Real k(unit = "1/s", min = 0.1, max = 50) = 2.5;
  parameter Real L(unit = "1/s", min = 0.05, max = 10) = 0.9;
  input Real u;
  output Real y(start = 0, fixed = true);
equation
  der(y) = if k * (u - y) > L then L else if k * (u - y) < -L then -L else k * (u - y);
end Limiter;
"""
TRUTH = {"Ball": {"g": 9.81, "e": 0.85}, "Relay": {"K": 3.0, "T": 2.0}, "Limiter": {"k": 3.0, "L": 0.8}}


def ball(time: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Parabolas between the bounces."""
    g, e = TRUTH["Ball"].values()
    found, begin, speed, height = np.empty_like(time), 0.0, 0.0, 1.0
    for _ in range(40):
        flight = (speed + np.sqrt(speed**2 + 2.0 * g * height)) / g
        now = (time >= begin) & (time < begin + flight)
        since = time[now] - begin
        found[now] = height + speed * since - 0.5 * g * since**2
        begin, speed, height = begin + flight, e * (g * flight - speed), 0.0
    return found


def relay(time: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Exponentials between -1 and 1."""
    gain, lag = TRUTH["Relay"].values()
    found, begin, x, side = np.empty_like(time), 0.0, 0.0, 1.0
    while begin <= time[-1]:
        length = lag * np.log((gain - side * x) / (gain - 1.0))
        now = (time >= begin) & (time < begin + length)
        found[now] = side * gain + (x - side * gain) * np.exp(-(time[now] - begin) / lag)
        begin, x, side = begin + length, side, -side
    return found


def limiter(time: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Straight lines, then exponentials, towards each level of the input."""
    gain, limit = TRUTH["Limiter"].values()
    found, y = np.empty_like(time), 0.0
    for k, step in enumerate(np.diff(time, append=time[-1])):
        found[k] = y
        off = u[k] - y
        straight = np.clip((abs(off) - limit / gain) / limit, 0.0, step)
        off -= np.sign(off) * limit * straight
        y = u[k] - off * np.exp(-gain * (step - straight))
    return found


@pytest.mark.parametrize(
    ("text", "run", "end", "sd"), [(BALL, ball, 2.5, 0.005), (RELAY, relay, 12.0, 0.02), (LIMITER, limiter, 40.0, 0.01)]
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_interval_leaves_the_truth_out(
    exported: Callable[[str], Model], text: str, run: Callable[..., np.ndarray], end: float, sd: float, seed: int
) -> None:
    rng, model = np.random.default_rng(seed), exported(text)
    time = np.linspace(0.0, end, 501)
    u = np.repeat(rng.choice([-1.0, 0.0, 0.2, 1.0], 26), 20)[:501]
    (output,), inputs = [v.name for v in model.outputs], {v.name: u for v in model.inputs}
    readings = run(time, u) + sd * rng.standard_normal(time.size)
    truth = TRUTH[model.name]
    fit = aero_bayes.fit(
        Recording("run", time, inputs, {output: readings}), model, parameters=list(truth),
        settings=FitSettings("local"), seed=seed, workers=0,
    )  # fmt: skip
    assert fit.rms[output] == pytest.approx(sd, rel=0.2)
    for name, true in truth.items():
        assert fit[name].value == pytest.approx(true, rel=0.02)
        if fit[name].sd is not None:
            assert abs(fit[name].value - true) < 4.5 * fit[name].sd
