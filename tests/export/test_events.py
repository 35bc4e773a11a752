"""Events and algebraic loops of exported models, against closed forms, in Model Exchange and Co-Simulation."""

from __future__ import annotations

from math import exp, log, sqrt
from pathlib import Path

import fmpy
import numpy as np
import pytest
from export_driver import driven
from numpy.typing import NDArray

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator

KINDS = pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])


def simulated(
    path: Path, kind: str, stop: float, outputs: list[str], step: float = 0.01, **options: object
) -> dict[str, NDArray[np.float64]]:
    """Values of outputs on the grid, the last row of an instant (after its event)."""
    found = fmpy.simulate_fmu(
        str(path),
        fmi_type=kind,
        stop_time=stop,
        output_interval=step,
        relative_tolerance=1e-10,
        output=outputs,
        **options,
    )
    last = np.r_[np.diff(found["time"]) > 0, True]
    return {n: np.asarray(found[n][last]) for n in ("time", *outputs)}


@KINDS
def test_bouncing_ball(kind, exported):
    path = exported("""within ;
model Ball
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
""")
    found = simulated(path, kind, 2.5, ["h", "n"])
    g, first = 9.81, sqrt(2 / 9.81)
    for t, h, n in zip(found["time"], found["h"], found["n"], strict=True):
        at, speed, count = first, 0.8 * g * first, 0
        if t <= first:
            assert h == pytest.approx(1 - g * t**2 / 2, abs=1e-7)
            continue
        while t > at + 2 * speed / g:
            at, speed, count = at + 2 * speed / g, 0.8 * speed, count + 1
        assert h == pytest.approx(speed * (t - at) - g * (t - at) ** 2 / 2, abs=1e-7)
        if min(t - at, at + 2 * speed / g - t) > 1e-6:
            assert n == count + 1


@KINDS
def test_relay_with_hysteresis(kind, exported):
    path = exported("""within ;
model Relay
  parameter Real low = 0.3, high = 0.7;
  output Real x(start = 0.5, fixed = true);
  output Boolean on(start = true, fixed = true);
equation
  on = x < low or (pre(on) and x <= high);
  der(x) = (if on then 1 else 0) - x;
end Relay;
""")
    found = simulated(path, kind, 6.0, ["x", "on"])
    up, down = log(0.7 / 0.3), log(0.7 / 0.3)
    first = log(0.5 / 0.3)
    for t, x, on in zip(found["time"], found["x"], found["on"], strict=True):
        if t < first:
            expected, rising, left = 1 - 0.5 * exp(-t), True, first - t
        else:
            phase = (t - first) % (up + down)
            rising = phase >= down
            expected = 1 - 0.7 * exp(-(phase - down)) if rising else 0.7 * exp(-phase)
            left = min(abs(phase), abs(phase - down), up + down - phase)
        assert x == pytest.approx(expected, abs=1e-7)
        if left > 1e-6:
            assert on == rising


@KINDS
def test_sampling_and_time_events(kind, exported):
    path = exported("""within ;
model Sampled
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
""")
    found = simulated(path, kind, 1.95, ["y", "sum", "step", "wave"], step=0.11)
    for k, t in enumerate(found["time"]):
        tick = int(t / 0.25 + 1e-9)
        assert found["y"][k] == pytest.approx(exp(-0.25 * tick), abs=1e-7)
        assert found["sum"][k] == pytest.approx(sum(exp(-0.25 * j) for j in range(tick)), abs=1e-6)
        assert found["step"][k] == (1.0 if t < 0.6 else 2.0)
        assert found["wave"][k] == pytest.approx(t % 0.3, abs=1e-7)


@KINDS
def test_dry_friction_sticks(kind, exported):
    # a block on a rough table under a force that grows and falls: it sticks, slides, and sticks again
    path = exported("""within ;
model Friction
  parameter Real m = 2, F_c = 3;
  output Real v(start = 0, fixed = true);
  output Real x(start = 0, fixed = true);
  Real F, f, a, s;
  Boolean locked, forward(start = false), backward(start = false);
  Integer mode(start = 0, fixed = true);
equation
  F = if time < 2 then 2 * time else 0;
  der(x) = v;
  der(v) = a;
  m * a = F - f;
  forward = pre(mode) == 0 and s > 1;
  backward = pre(mode) == 0 and s < -1;
  locked = not (pre(mode) == 1 or forward or pre(mode) == -1 or backward);
  f = F_c * (if locked then s else if forward or pre(mode) == 1 then 1 else -1);
  a = if locked then 0 else if forward or pre(mode) == 1 then s - 1 else s + 1;
  mode = if (pre(mode) == 1 or forward) and v > 0 then 1 else if (pre(mode) == -1 or backward) and v < 0 then -1 else 0;
end Friction;
""")
    found = simulated(path, kind, 3.0, ["v", "x"])
    # sliding begins where 2 t = 3; v = (t - 1.5)^2 / 2 until t = 2, then falls by 1.5 a second to zero
    top = 0.5**2 / 2
    end = 2 + top / 1.5
    for t, v in zip(found["time"], found["v"], strict=True):
        expected = 0.0 if t < 1.5 or t > end else (t - 1.5) ** 2 / 2 if t < 2 else top - 1.5 * (t - 2)
        assert v == pytest.approx(expected, abs=1e-6)
    assert found["x"][-1] == pytest.approx(0.5**3 / 6 + top**2 / 3, abs=1e-6)


@KINDS
def test_rectifier_with_an_ideal_diode(kind, exported):
    # half-wave rectifier with an inductance: L di/dt = sin t while the diode conducts, i = 1 - cos t up to t = 2 pi
    path = exported(
        """within ;
model Diode
  output Real i(start = 0, fixed = true);
  output Real power;
  Real s(start = 0), v, u;
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
""".replace("Real s(start = 0), v, u;", "Real s(start = 0), v, u, i_d, r;")
    )
    found = simulated(path, kind, 6.0, ["i", "power"])
    u = np.sin(found["time"]) - 0.2
    np.testing.assert_allclose(found["power"], np.where(u > 0, u * u / 2, 0.0), atol=1e-7)


@KINDS
def test_loops_that_are_not_linear(kind, exported):
    path = exported("""within ;
model Loop
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
""")
    found = simulated(path, kind, 3.0, ["y", "r"])
    x = np.exp(-found["time"])
    np.testing.assert_allclose(found["y"] ** 3 + 2 * found["y"], x, atol=1e-8)
    # q solves q^2 + q (exp(-q) + x) = 4 + x
    q = np.full_like(x, 2.0)
    for _ in range(60):
        f, slope = q**2 + q * (np.exp(-q) + x) - 4 - x, 2 * q + np.exp(-q) + x - q * np.exp(-q)
        q = q - f / slope
    np.testing.assert_allclose(found["r"], q + (4 + x) / q, atol=1e-7)
    with driven(path) as fmu:
        fmu.begin()
        y = fmu.get("y")[0]
        assert fmu.slope(["y"], "x")[0] == pytest.approx(1 / (3 * y**2 + 2), rel=1e-10)
        assert fmu.slope(["y"], "a")[0] == pytest.approx(-y / (3 * y**2 + 2), rel=1e-10)
        step = 1e-6
        above, below = (fmu.rhs(np.array([1 + d])) is not None and fmu.get("r")[0] for d in (step, -step))
        fmu.rhs(np.array([1.0]))
        assert fmu.slope(["r"], "x")[0] == pytest.approx((above - below) / (2 * step), rel=1e-6)


def test_an_assertion_warns_and_makes_no_event(exported, capsys):
    path = exported("""within ;
model Watched
  Real x(start = 1, fixed = true);
  output Real y;
equation
  der(x) = -x;
  y = 2 * x;
  assert(x > 0.5, "x is small");
  when y < 0.2 then
    reinit(x, 1);
  end when;
end Watched;
""")
    found = simulated(path, "ModelExchange", 3.0, ["y"], debug_logging=True)
    assert int(fmpy.read_model_description(str(path)).numberOfEventIndicators) == 1
    np.testing.assert_allclose(
        found["y"][found["time"] < log(10)], 2 * np.exp(-found["time"][found["time"] < log(10)]), atol=1e-7
    )
    assert "x is small" in capsys.readouterr().out


def test_initial_equations_that_are_not_linear(exported):
    # x^3 + x = a at the start, and z at rest behind a loop y^3 + y = z
    path = exported("""within ;
model Beginning
  parameter Real a = 10, b = 3;
  Real x(start = 1), z(start = 1), y(start = 1);
  output Real u, free;
  input Real unrelated;
initial equation
  x ^ 3 + x = a;
  der(z) = 0;
equation
  der(x) = -x;
  y ^ 3 + y = z;
  der(z) = b - y;
  u = x + y;
  free = unrelated ^ 2;
end Beginning;
""")
    with driven(path) as fmu:
        fmu.set(a=30.0, b=2.0)
        fmu.begin()
        x, z = fmu.get("x", "z")
        assert x**3 + x == pytest.approx(30.0, rel=1e-12)
        assert z == pytest.approx(2.0**3 + 2.0, rel=1e-12)
        known = {u.variable.name: {d.name for d in u.dependencies} for u in fmu.description.outputs}
        assert known == {"u": {"x", "z"}, "free": {"unrelated"}}


def test_a_beginning_at_rest_that_the_inputs_decide_is_left_to_them(exported):
    # without a flow there is no such temperature
    path = exported("""within ;
model Stream
  input Real m "flow";
  input Real T_in;
  output Real T;
  parameter Real P = 6;
initial equation
  der(T) = 0;
equation
  der(T) = m * (T_in - T) + P;
end Stream;
""")
    with driven(path) as fmu:
        fmu.set(m=2.0, T_in=20.0)
        fmu.begin()
        assert fmu.get("T") == [pytest.approx(23.0)]


def test_the_engine_takes_the_events_of_an_exported_model(modelica, tmp_path):
    # a ball that is sampled twice a second, and kicked by a step of the input
    source = modelica("""within ;
model Kicked
  input Real u;
  parameter Real e = 0.5;
  Real h(start = 1, fixed = true), v(start = 0, fixed = true);
  discrete Real last(start = 0, fixed = true);
  output Real height, seen;
equation
  der(h) = v;
  der(v) = -9.81;
  when h < 0 then
    reinit(v, -e * pre(v));
  elsewhen u > 0.5 then
    reinit(v, 3);
  end when;
  when sample(0, 0.5) then
    last = h;
  end when;
  height = h;
  seen = last;
end Kicked;
""")
    model = Model.load(export_fmu("Kicked", tmp_path / "k.fmu", compiler="embedded", sources=[source]))
    time = np.linspace(0.0, 1.2, 121)
    signal = InputSignal("u", np.array([0.0, 0.305]), np.array([0.0, 1.0]))
    experiment = Experiment(time, ("height", "seen"), (signal,))
    problem = Problem(model, (experiment,), ((ParameterTarget("e"),),), {}, SolverSettings(1e-9, 1e-9))
    with NativeSimulator(problem, workers=0) as simulator:
        found = simulator.simulate(np.array([[0.5]]))
    assert found.outcomes[0, 0] == Outcome.OK
    g, kick = 9.81, 0.305
    top = 1 - g * kick**2 / 2
    fall = (3 + sqrt(9 + 2 * g * top)) / g
    speed = 0.5 * (g * fall - 3)

    def height(t: float) -> float:
        if t < kick:
            return 1 - g * t**2 / 2
        if t < kick + fall:
            return top + 3 * (t - kick) - g * (t - kick) ** 2 / 2
        return speed * (t - kick - fall) - g * (t - kick - fall) ** 2 / 2

    assert kick + fall < 1.2 < kick + fall + 2 * speed / g
    np.testing.assert_allclose(found.outputs[0][0][:, 0], [height(t) for t in time], atol=1e-7)
    away = np.abs(time % 0.5) > 1e-6
    np.testing.assert_allclose(
        found.outputs[0][0][away, 1], [height(0.5 * int(t / 0.5)) for t in time[away]], atol=1e-7
    )


def test_the_shipped_experiment_is_the_bench_under_the_same_step(exported, aero_fmu):
    path = exported(
        "within ;\nmodel Watched\n  extends Aero.Experiments.PaperStep;\n  output Real theta, speed;\nequation\n"
        "  theta = bench.theta;\n  speed = bench.omega_m;\nend Watched;\n",
        "Watched",
    )
    found = simulated(path, "CoSimulation", 22.0, ["theta", "speed"], step=0.1)
    time = found["time"]
    steps = np.array([(0.0, 24.0), (20.0, 0.0)], dtype=[("time", float), ("V_m", float)])
    model = Model.load(aero_fmu("OneDof"))
    signal = InputSignal("V_m", steps["time"], steps["V_m"])
    problem = Problem(
        model, (Experiment(time, ("theta", "omega_m"), (signal,)),), ((),), {}, SolverSettings(1e-10, 1e-10)
    )
    with NativeSimulator(problem, workers=0) as simulator:
        expected = simulator.simulate(np.empty((1, 0))).outputs[0][0]
    np.testing.assert_allclose(found["theta"], expected[:, 0], atol=1e-6)
    np.testing.assert_allclose(found["speed"], expected[:, 1], atol=1e-4)
