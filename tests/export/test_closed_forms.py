"""Events, loops and starts of exported models against closed forms: a source, and the outputs over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import log
from pathlib import Path

import fmpy
import numpy as np
import pytest
from export_driver import driven
from numpy.typing import NDArray
from scipy.optimize import brentq

FloatArray = NDArray[np.float64]
Outputs = Callable[[FloatArray], Mapping[str, object]]
BOTH = ("ModelExchange", "CoSimulation")


def simulated(
    path: Path, kind: str, stop: float, outputs: list[str], step: float = 0.01, **options: object
) -> dict[str, FloatArray]:
    """Values of outputs on the grid, the last row of an instant (after its event)."""
    found = fmpy.simulate_fmu(
        str(path), fmi_type=kind, stop_time=stop, output_interval=step, relative_tolerance=1e-10, output=outputs,
        **options,
    )  # fmt: skip
    last = np.r_[np.diff(found["time"]) > 0, True]
    return {n: np.asarray(found[n][last]) for n in ("time", *outputs)}


def ball(t: FloatArray) -> Mapping[str, object]:
    g = 9.81
    speeds = np.sqrt(2 * g) * 0.8 ** np.arange(1, 15)
    at = np.sqrt(2 / g) + np.cumsum(np.r_[0.0, 2 * speeds[:-1] / g])
    n = np.searchsorted(at, t + 1e-6)  # a row of the instant itself is after its event
    since, v = t - at[n - 1], speeds[n - 1]
    return {"h": np.where(n == 0, 1 - g * t**2 / 2, v * since - g * since**2 / 2), "n": n}


def relay(t: FloatArray) -> Mapping[str, object]:
    half, first = log(0.7 / 0.3), log(0.5 / 0.3)
    phase = (t - first) % (2 * half)
    on = (t < first) | (phase >= half)
    late = np.where(phase >= half, 1 - 0.7 * np.exp(half - phase), 0.7 * np.exp(-phase))
    return {"x": np.where(t < first, 1 - 0.5 * np.exp(-t), late), "on": on}


def sampled(t: FloatArray) -> Mapping[str, object]:
    tick = (t / 0.25 + 1e-9).astype(int)
    held = np.exp(-0.25 * np.arange(tick.max() + 1))
    return {"y": held[tick], "sum": np.r_[0.0, np.cumsum(held)][tick], "step": np.where(t < 0.6, 1, 2), "wave": t % 0.3}


def loop(t: FloatArray) -> Mapping[str, object]:
    """``q`` solves q^2 + q (exp(-q) + x) = 4 + x."""
    x = np.exp(-t)
    q = np.array([brentq(lambda q, x=x: q**2 + q * (np.exp(-q) + x) - 4 - x, 0, 9, xtol=1e-14) for x in x])
    return {"y": [brentq(lambda y, x=x: y**3 + 2 * y - x, -1, 2, xtol=1e-14) for x in x], "r": q + (4 + x) / q}


def contact(t: FloatArray) -> Mapping[str, object]:
    """Full steps of Newton's method go from one side of the step to the other for ever."""
    u = 5 * np.sin(7 * t)
    i = [brentq(lambda i, v=v: 1e3 * i + 0.35 * np.tanh(i / 1e-6) - v, -1, 1, xtol=1e-18, rtol=1e-15) for v in u]
    return {"drop": u - 1e3 * np.array(i)}


def solved(a: float) -> Outputs:
    p = float(np.roots([1.0, 0.0, 1.0, -10.0 * a]).real.max())
    return lambda t: {"x": np.exp(-p * t), "y": np.full_like(t, 2.0 * p)}


def chain(t: FloatArray) -> Mapping[str, object]:
    rate = 4.0 / 17.0 / 4.0  # share / root
    return {"y": 8.0 + t / rate - (1.0 - np.exp(-rate * t)) / rate**2}


def own(t: FloatArray) -> Mapping[str, object]:
    """The first event is that of initial(), which moves the instant too."""
    ticks = np.searchsorted([0.625, 0.925], t, side="right")
    return {"y": 2.0 * np.array([0.0, 0.625, 0.925])[ticks] + 100.0 * (ticks + 1.0)}


def filters(t: FloatArray) -> Mapping[str, object]:
    """The reading is 1.8 exp(-t) - 0.25 exp(-2 t), 1.55 at the start."""
    one, two = np.exp(-t), np.exp(-2 * t)
    fast = 2 * one - 0.3125 * two - 0.1375 * np.exp(-10 * t)
    return {"y": 0.6 * one, "a": fast, "b": (1.8 * t + 1.3) * one + 0.25 * two}


LOOP = """model Loop
  parameter Real a = 2;
  Real x(start = 1, fixed = true), p(start = 1), q(start = 1);
  output Real y(start = 1), r;
equation
  der(x) = -x;
  y ^ 3 + a * y = x;
  p * q = 4 + x;
  p - q = exp(-q) + x;
  r = p + q;
end Loop;
"""
SOLVED = """model Solved
  parameter Real a = 3;
  parameter Real p(fixed = false, start = 1);
  parameter Real q = 2 * p;
  output Real x(start = 1, fixed = true);
  output Real y = q;
initial equation
  p ^ 3 + p = 10 * a;
equation
  der(x) = -p * x;
end Solved;
"""
#: In Model Exchange and Co-Simulation: stop, step, source, outputs.
IN_BOTH: list[tuple[float, float, str, Outputs]] = [
    (2.5, 0.01, """model Ball
  parameter Real e = 0.8;
  output Real h(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
  output Integer n(start = 0, fixed = true);
equation
  der(h) = v;
  der(v) = -9.81;
  when h < 0 then
    reinit(v, -e * pre(v));
    n = pre(n) + 1;
  end when;
end Ball;
""", ball),
    (6.0, 0.01, """model Relay
  parameter Real low = 0.3, high = 0.7;
  output Real x(start = 0.5, fixed = true);
  output Boolean on(start = true, fixed = true);
equation
  on = x < low or (pre(on) and x <= high);
  der(x) = (if on then 1 else 0) - x;
end Relay;
""", relay),
    (1.95, 0.11, """model Sampled
  parameter Real T = 0.25;
  Real x(start = 1, fixed = true);
  discrete Real held(start = 0, fixed = true), total(start = 0, fixed = true);
  output Real y, sum, step, wave;
equation
  der(x) = -x;
  when sample(0, T) then
    held = x;
    total = pre(total) + pre(held);
  end when;
  y = held;
  sum = total;
  step = if time < 0.6 then 1 else 2;
  wave = mod(time, 0.3);
end Sampled;
""", sampled),
    (6.0, 0.01, """model Diode
  output Real i(start = 0, fixed = true);
  output Real power;
  Real s(start = 0), v, u, i_d, r;
  Boolean off(start = true);
equation
  u = sin(time) - 0.2;
  off = s < 0;
  v = if off then s else 0;
  i_d = if off then 0 else s;
  u = v + r * i_d;
  der(i) = i_d - i;
  power = u * i_d;
  r = 2;
end Diode;
""", lambda t: {"power": np.maximum(np.sin(t) - 0.2, 0.0) ** 2 / 2}),
    (3.0, 0.01, LOOP, loop),
    # the Prothero-Robinson problem is stiff
    (10.0, 0.1, """model Robinson
  Real x(start = 1, fixed = true);
  output Real y = x, late = x + time;
equation
  der(x) = -2000 * (x - cos(time)) - sin(time);
end Robinson;
""", lambda t: {"y": np.cos(t), "late": np.cos(t) + t}),
]  # fmt: skip
#: In Co-Simulation over one second: given parameters, source, outputs, and by how much they may differ.
IN_ONE: list[tuple[dict[str, float], str, Outputs, float]] = [
    # pre() of an algebraic variable is its left limit: of what jumps in the same event, the old value
    ({}, """model Held
  discrete Real a(start = 0, fixed = true);
  Real u = a + time;
  output Real y(start = 0, fixed = true);
equation
  when sample(0.1, 0.1) then
    a = pre(a) + 1;
    y = pre(u);
  end when;
end Held;
""", lambda t: {"y": np.maximum((k := np.floor(t / 0.1 + 1e-9)) - 1.0, 0.0) + 0.1 * k}, 1e-9),
    # an event at the end of a step belongs to it
    ({}, """model Late
  output Real y = if time < 0.5 then 0 else 1;
end Late;
""", lambda t: {"y": t >= 0.5 - 1e-9}, 0),
    ({"a": 3.0}, SOLVED, solved(3.0), 1e-7),
    ({"a": 1.0}, SOLVED, solved(1.0), 1e-7),
    # a start that depends on an input and on a branch
    ({"u": 4.0}, """model Start
  input Real u(start = 2);
  output Real x;
  output Real z;
initial equation
  x = u;
  z = if time < 1 then 3 * x else 0;
equation
  der(x) = u - x;
  der(z) = -z;
end Start;
""", lambda t: {"x": np.full_like(t, 4.0), "z": 12.0 * np.exp(-t)}, 1e-7),
    # what flows out has the enthalpy that flows in; on the branch of reverse flow the equation says nothing of it
    ({}, """model Outflow
  parameter Real q_0 = 0.1;
  Real q = q_0 * (1 + time);
  Real h, port;
  output Real T(start = 1, fixed = true);
equation
  semiLinear(-q, port, h) = -q * 5;
  semiLinear(-q, port, h) + semiLinear(q, port, T) = 0;
  der(T) = port - T;
end Outflow;
""", lambda t: {"T": 5.0 - 4.0 * np.exp(-t)}, 1e-7),
    # a function with several results in a when clause of an algorithm, its arguments the values before
    ({}, """model Own
  function f
    input Real t;
    input Integer k;
    output Real a;
    output Integer n;
  algorithm
    a := 2 * t;
    n := k + 1;
  end f;
  Real a(start = 0);
  Integer n(start = 0);
  Real due(start = 0.325, fixed = true);
  output Real y = a + 100 * n;
algorithm
  when {time >= pre(due), initial()} then
    (a, n) := f(time, n);
    due := pre(due) + 0.3;
  end when;
end Own;
""", own, 1e-6),
    # a chain of initial equations that Newton's method cannot start at zero: each root is there once others are known
    ({"given": 16.0}, """model Chain
  parameter Real given = 9;
  parameter Real root(fixed = false), power(fixed = false), share(fixed = false);
  Real x;
  output Real y = x;
initial equation
  share = root / power;
  power = root ^ 2 + 1;
  root = sqrt(given);
  der(x) = 0;
equation
  der(x) = share * (2 - x / root) + time;
end Chain;
""", chain, 1e-6),
    # what rounding leaves of terms of 1e9 is far more than the loop's result, which passes zero
    ({}, """model Small
  Real s = if time > 2 then 2 else 0.5;
  Real large = 1e9 * (1 + sin(time));
  Real one(start = 1), two;
  output Real y(start = 0, fixed = true);
equation
  one + s * two = large;
  s * one + two = s * large + cos(10 * time);
  der(y) = two;
end Small;
""", lambda t: {"y": np.sin(10 * t) / 10 / 0.75}, 1e-5),
    ({}, """model Contact
  Real u = 5 * sin(7 * time), i;
  output Real charge(start = 0, fixed = true);
  output Real drop = u - 1000 * i;
equation
  u = 1000 * i + 0.35 * tanh(i / 1e-6);
  der(charge) = i;
end Contact;
""", contact, 1e-5),
    # two locked frictions share the load
    ({}, """model Shared
  parameter Real load = 3;
  Real v(start = 0, fixed = true), a, one, two;
  Boolean locked = time < 0.5;
  output Real y = v, held = one + two;
equation
  der(v) = a;
  a = load - one - two;
  0 = if locked then a else one - 0.5;
  0 = if locked then 2 * a else two - 0.25 * load;
end Shared;
""", lambda t: {"y": 1.75 * np.maximum(t - 0.5, 0.0), "held": np.where(t < 0.5 - 1e-9, 3.0, 1.25)}, 1e-9),
    # the tolerance holds for small states
    ({}, """model Flux
  Real x(start = 1e-6, fixed = true), v(start = 0, fixed = true);
  output Real y = 1e6 * x;
equation
  der(x) = v;
  der(v) = -400 * x;
end Flux;
""", lambda t: {"y": np.cos(20 * t)}, 1e-4),
    # a while loop that a condition on a variable ends
    ({}, """model Turns
  function below
    input Real x;
    input Real rows[:];
    output Integer n;
  algorithm
    n := 0;
    while n < size(rows, 1) and x >= rows[n + 1] loop
      n := n + 1;
    end while;
  end below;
  output Real n = below(time, {0.12, 0.33, 0.33, 0.71});
end Turns;
""", lambda t: {"n": (t[:, None] >= np.array([0.12, 0.33, 0.33, 0.71])).sum(axis=1)}, 1e-9),
    # friction that comes to rest is stuck under a push that either direction of sliding would answer by turning round
    ({}, """model Rest
  parameter Real push = 1, hold = 3;
  Real w(start = -2, fixed = true), a, sa, tau;
  Boolean forward(start = false, fixed = true), backward(start = false, fixed = true), locked;
  Integer mode(start = -1, fixed = true);
  output Real y = w;
equation
  der(w) = a;
  a = push - tau;
  forward = pre(mode) == 0 and sa > hold;
  backward = pre(mode) == 0 and sa < -hold;
  locked = not (pre(mode) == 1 or forward or pre(mode) == -1 or backward);
  a = if locked then 0 elseif forward or pre(mode) == 1 then sa - hold else sa + hold;
  tau = if locked then sa elseif forward or pre(mode) == 1 then hold else -hold;
  mode = if (pre(mode) == 1 or forward) and w > 0 then 1 elseif (pre(mode) == -1 or backward) and w < 0 then -1 else 0;
end Rest;
""", lambda t: {"y": np.minimum(-2 + 4 * t, 0.0)}, 1e-8),
    # two filters start where a reading is that depends on states that are free: these keep their own starts
    ({}, """model Filters
  Real one(start = 0.6), two(start = 0.25);
  Real fast, slow;
  Real reading = 3 * one - two;
  output Real y = one;
  output Real a = fast, b = slow;
initial equation
  fast = reading;
  slow = reading;
equation
  der(one) = -one;
  der(two) = -2 * two;
  der(fast) = 10 * (reading - fast);
  der(slow) = reading - slow;
end Filters;
""", filters, 1e-6),
]  # fmt: skip


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize(("stop", "step", "text", "outputs"), IN_BOTH, ids=[case[2].split()[1] for case in IN_BOTH])
def test_in_model_exchange_and_co_simulation(kind, stop, step, text, outputs, exported):
    names = [*outputs(np.zeros(1))]
    found = simulated(exported(text), kind, stop, names, step)
    for name, expected in outputs(found["time"]).items():
        np.testing.assert_allclose(found[name], expected, atol=1e-6 if name in ("sum", "late") else 1e-7, err_msg=name)


@pytest.mark.parametrize(("given", "text", "outputs", "tolerance"), IN_ONE, ids=[case[1].split()[1] for case in IN_ONE])
def test_in_co_simulation(given, text, outputs, tolerance, exported):
    names = [*outputs(np.zeros(1))]
    found = simulated(exported(text), "CoSimulation", 1.0, names, 0.05, start_values=given)
    for name, expected in outputs(found["time"]).items():
        np.testing.assert_allclose(found[name], expected, atol=tolerance, rtol=1e-7, err_msg=name)


def test_derivatives_through_a_loop(exported):
    with driven(exported(LOOP)) as fmu:
        fmu.begin()
        y = fmu.get("y")[0]
        assert fmu.slope(["y"], "x")[0] == pytest.approx(1 / (3 * y**2 + 2), rel=1e-10)
        assert fmu.slope(["y"], "a")[0] == pytest.approx(-y / (3 * y**2 + 2), rel=1e-10)
        above, below = (fmu.rhs(np.array([1 + d])) is not None and fmu.get("r")[0] for d in (1e-6, -1e-6))
        fmu.rhs(np.array([1.0]))
        assert fmu.slope(["r"], "x")[0] == pytest.approx((above - below) / 2e-6, rel=1e-6)
