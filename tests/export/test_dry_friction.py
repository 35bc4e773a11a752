"""Dry friction as most people write it: it sticks and slides without chattering, under every master."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from export_driver import driven
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from aero_bayes.modelica.causalisation import causalise
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.switching_surfaces import find_surfaces
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, ParameterTarget, Problem, StartTarget
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator

Export = Callable[..., Path]
FloatArray = NDArray[np.float64]
KINDS = pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
SIGN = "F_c * sign(v)"
BRANCH = "F_c * (if v > 0 then 1 else -1)"
BRANCHES = "(if v > 0 then F_c elseif v < 0 then -F_c else 0)"
NO_EVENT = "F_c * noEvent(if v >= 0 then 1 else -1)"
BOOLEAN = "F_c * (if forward then 1 else -1)"
FRICTIONS = pytest.mark.parametrize("friction", [SIGN, BRANCH, BRANCHES, NO_EVENT, BOOLEAN])
M, K, F_C = 0.7, 40.0, 0.5


def sledge(exported: Export, friction: str = SIGN, start: float = 0.1) -> Path:
    declared = "Boolean forward;" if "forward" in friction else ""
    equation = "forward = v > 0;" if "forward" in friction else ""
    return exported(f"""model Sledge "A mass on a spring with dry friction"
  parameter Real m = {M};
  parameter Real k = {K};
  parameter Real F_c = {F_C};
  input Real F;
  output Real s(start = {start}, fixed = true);
  output Real v(start = 0, fixed = true);
  output Real f "Friction";
  {declared}
equation
  {equation}
  der(s) = v;
  m * der(v) = F - k * s - f;
  f = {friction};
end Sledge;
""")


def stick_slip(time: FloatArray, force: FloatArray, k: float, f_c: float, start: float = 0.0) -> FloatArray:
    """Positions of the mass under a force held from each instant on: each phase in closed form, no steps."""
    w = np.sqrt(k / M)
    s, v, found = start, 0.0, [start]
    for begin, end, pull in zip(time[:-1], time[1:], force[:-1], strict=True):
        left = end - begin
        while left > 0.0:
            if v == 0.0 and abs(pull - k * s) <= f_c:
                break
            way = np.sign(v) if v != 0.0 else np.sign(pull - k * s)
            middle = (pull - way * f_c) / k
            # s = middle + a cos(w t) + b sin(w t) until the speed returns to zero
            a, b = s - middle, v / w
            turn = np.arctan2(b, a) % np.pi / w
            turn = turn if turn > 1e-12 else np.pi / w
            ahead = min(left, turn)
            s = middle + a * np.cos(w * ahead) + b * np.sin(w * ahead)
            v = 0.0 if turn <= left else w * (b * np.cos(w * ahead) - a * np.sin(w * ahead))
            left -= ahead
        found.append(s)
    return np.array(found)


def pulls() -> tuple[FloatArray, FloatArray]:
    """Two seconds of a force that changes at each of 41 samples; the mass rests in some of them."""
    time = np.linspace(0.0, 2.0, 41)
    force = 2.0 * np.sin(3.0 * time) + np.where((time > 0.7) & (time < 1.1), 0.0, 0.4 * np.cos(40.0 * time))
    return time, np.round(force, 3)


@KINDS
@FRICTIONS
def test_free_decay(kind, friction, exported):
    path = sledge(exported, friction)
    found = fmpy.simulate_fmu(
        str(path), fmi_type=kind, stop_time=3.0, output_interval=0.01, relative_tolerance=1e-9, output=["s", "v", "f"]
    )
    last = np.r_[np.diff(found["time"]) > 0, True]
    time, s = found["time"][last], found["s"][last]
    np.testing.assert_allclose(s, stick_slip(time, 0.0 * time, K, F_C, 0.1), atol=1e-6)
    rest = time > 2.0
    assert np.max(np.abs(found["v"][last][rest])) < 1e-9
    np.testing.assert_allclose(found["f"][last][rest], -K * s[rest], atol=1e-7)  # friction at rest carries the spring


@FRICTIONS
def test_pulled_and_resting_in_turns(friction, exported):
    """The native engine and its sensitivities against phases in closed form."""
    time, force = pulls()
    model = Model.load(sledge(exported, friction))
    experiment = Experiment(time, ("s",), (InputSignal("F", time, force, "hold"),))
    problem = Problem(model, (experiment,), ((ParameterTarget("k"), ParameterTarget("F_c"), StartTarget("s")),))
    with NativeSimulator(problem) as simulator:
        plain = simulator.simulate(np.array([[K, F_C, 0.0], [55.0, 0.8, 0.0]]))
        found = simulator.simulate(np.array([[K, F_C, 0.0]]), active=[0, 1, 2])
    assert np.all(plain.outcomes == Outcome.OK)
    assert np.all(found.outcomes == Outcome.OK)
    for row, (k, f_c) in zip(plain.outputs[0][:, :, 0], ((K, F_C), (55.0, 0.8)), strict=True):
        np.testing.assert_allclose(row, stick_slip(time, force, k, f_c), atol=1e-6 * 0.06)
    np.testing.assert_allclose(found.outputs[0][0, :, 0], stick_slip(time, force, K, F_C), atol=1e-6 * 0.06)
    assert found.sensitivities is not None
    for column, step in enumerate((1e-4, 1e-6, 1e-7)):
        change = np.zeros(3)
        change[column] = step
        above, below = (stick_slip(time, force, *(np.array([K, F_C, 0.0]) + d)) for d in (change, -change))
        slope = (above - below) / (2.0 * step)
        np.testing.assert_allclose(found.sensitivities[0][0, :, 0, column], slope, atol=1e-3 * np.max(np.abs(slope)))


TWO = """model Two "A block on a sledge: friction between them, and between sledge and ground"
  parameter Real mu_1 = 1.2;
  parameter Real mu_2 = 0.5;
  output Real v(start = 0, fixed = true), w(start = 0, fixed = true);
  input Real F;
  Real f;
equation
  f = mu_2 * sign(v - w);
  2 * der(v) = F - mu_1 * sign(v) - f;
  der(w) = f;
end Two;
"""


@KINDS
def test_two_surfaces_at_once(kind, exported):
    """At F = 1 both rest, at 2 both move as one (0.8 / 3 < 0.5), at 5 the block slips; then all comes to rest."""
    path = exported(TWO)
    signal = np.array(
        [(0, 1), (1, 1), (1, 2), (2, 2), (2, 5), (3, 5), (3, 0), (6, 0)], dtype=[("time", float), ("F", float)]
    )
    found = fmpy.simulate_fmu(
        str(path), fmi_type=kind, input=signal, output=["v", "w"], stop_time=6.0, output_interval=0.1,
        relative_tolerance=1e-9,
    )  # fmt: skip
    last = np.r_[np.diff(found["time"]) > 0, True]
    t, v, w = (found[n][last] for n in ("time", "v", "w"))
    together, slip_v, slip_w = 0.8 / 3.0, (5 - 1.7) / 2.0, 0.5
    # from t = 3 on the sledge slows by 1.7 / 2 while the block still gains 0.5, then both by 0.4
    meet = 3.0 + (slip_v - slip_w) / (0.85 + 0.5)
    speed = together + slip_w * (meet - 2.0)

    def expected(t: float) -> tuple[float, float]:
        if t <= 1.0:
            return 0.0, 0.0
        if t <= 2.0:
            return together * (t - 1), together * (t - 1)
        if t <= 3.0:
            return together + slip_v * (t - 2), together + slip_w * (t - 2)
        if t <= meet:
            return together + slip_v - 0.85 * (t - 3), together + slip_w * (t - 2)
        return (max(0.0, speed - 0.4 * (t - meet)),) * 2

    np.testing.assert_allclose(np.stack([v, w], 1), np.array([expected(x) for x in t]), atol=1e-6)


CONTROL = """model Control "A switching controller keeps y = p - c x^2, a curve"
  parameter Real c = 0.3;
  parameter Real p = 1;
  output Real x(start = 0.2, fixed = true), y(start = 0.5, fixed = true);
  output Real u;
equation
  u = if y + c * x ^ 2 > p then -3 else 3;
  der(x) = y - x;
  der(y) = u + x * y;
end Control;
"""


def test_a_curved_surface_and_its_derivatives(exported):
    path = exported(CONTROL)
    time = np.linspace(0.0, 3.0, 61)
    problem = Problem(Model.load(path), (Experiment(time, ("x", "y", "u")),), ((ParameterTarget("c"),),))
    with NativeSimulator(problem) as simulator:
        found = simulator.simulate(np.array([[0.3]]))
    assert found.outcomes[0, 0] == Outcome.OK
    x, y, u = found.outputs[0][0].T
    reached = solve_ivp(
        lambda t, z: [z[1] - z[0], 3 + z[0] * z[1]], (0, 1), [0.2, 0.5], rtol=1e-11, atol=1e-12,
        events=lambda t, z: z[1] + 0.3 * z[0] ** 2 - 1,
    )  # fmt: skip
    at, (begin, _) = reached.t_events[0][0], reached.y_events[0][0]
    on = time > at + 1e-6
    reduced = solve_ivp(
        lambda t, z: [1 - 0.3 * z[0] ** 2 - z[0]], (at, 3), [begin], t_eval=time[on], rtol=1e-11, atol=1e-12
    )
    np.testing.assert_allclose(x[on], reduced.y[0], atol=1e-6)
    np.testing.assert_allclose(y[on], 1 - 0.3 * x[on] ** 2, atol=1e-6)
    # on the curve y' = -2 c x x' = u + x y
    np.testing.assert_allclose(u[on], -0.6 * x[on] * (y[on] - x[on]) - x[on] * y[on], atol=1e-5)

    with driven(path) as fmu:
        point = np.array([0.2, 1 - 0.3 * 0.04])
        fmu.set(x=point[0], y=point[1])
        fmu.begin()
        assert fmu.rhs(point)[1] == pytest.approx(-0.12 * (point[1] - 0.2), abs=1e-9)
        for name, change in (("x", np.array([1.0, 0.0])), ("y", np.array([0.0, 1.0]))):
            above, below = (np.append(fmu.rhs(point + d * 1e-6 * change), fmu.get("u")) for d in (1, -1))
            fmu.rhs(point)
            np.testing.assert_allclose(fmu.slope([*fmu.rates, "u"], name), (above - below) / 2e-6, atol=1e-7)
        values = []
        for c in (0.3 + 1e-6, 0.3 - 1e-6):
            fmu.set(c=c)
            values.append(np.append(fmu.rhs(point), fmu.get("u")))
        fmu.set(c=0.3)
        fmu.rhs(point)
        np.testing.assert_allclose(fmu.slope([*fmu.rates, "u"], "c"), (values[0] - values[1]) / 2e-6, atol=1e-7)


def test_turns_are_counted_once(exported):
    """A when clause on the same relation fires at each turn, not at each trial of a side."""
    path = exported(f"""model Counted
  output Real s(start = 0.1, fixed = true);
  Real v(start = 0, fixed = true);
  output Integer n(start = 0, fixed = true);
equation
  der(s) = v;
  {M} * der(v) = -{K} * s - {F_C} * sign(v);
  when v > 0 then
    n = pre(n) + 1;
  end when;
end Counted;
""")
    found = fmpy.simulate_fmu(str(path), stop_time=3.0, output=["s", "n"], relative_tolerance=1e-8)
    end = stick_slip(np.array([0.0, 3.0]), np.zeros(2), K, F_C, 0.1)[-1]
    np.testing.assert_allclose(found["s"][-1], end, atol=1e-6)
    half_periods = int(np.ceil((0.1 - F_C / K) / (2.0 * F_C / K)))
    assert found["n"][-1] in (half_periods // 2, half_periods // 2 + 1)


@pytest.mark.parametrize(
    ("equation", "surfaces"),
    [
        ("der(v) = -c * v * abs(v)", 0),
        ("der(v) = -c * v ^ 2 * sign(v)", 0),
        ("der(v) = if v > 0 then -c * v else -2 * c * v", 0),
        ("der(v) = if x > 0 then -c else c", 0),
        ("der(v) = -c * sign(v)", 1),
        ("der(v) = -c * sign(2 * v) + (if -v > 0 then 1 else 0)", 1),
        ("der(v) = -c * sign(v) - sign(v - x)", 2),
    ],
)
def test_only_what_can_slide_is_watched(equation, surfaces, modelica):
    source = modelica(
        "model Watched\n  parameter Real c = 1;\n  Real x(start = 1), v(start = 1);\nequation\n  der(x) = v;\n"
        f"  {equation};\nend Watched;\n",
        "Watched",
    )
    found = find_surfaces(causalise(translate(load_flat("Watched", [source]))))
    assert len(found.surfaces) == surfaces
