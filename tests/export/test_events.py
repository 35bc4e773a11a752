"""Events and algebraic loops of exported models, against closed forms, in Model Exchange and Co-Simulation."""

from __future__ import annotations

from math import log, sqrt

import fmpy
import numpy as np
import pytest
from export_driver import driven
from test_closed_forms import simulated

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator


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
