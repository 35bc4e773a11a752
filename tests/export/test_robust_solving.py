"""Initial equations, loops and algorithms that need care, against closed forms."""

from __future__ import annotations

import math

import fmpy
import numpy as np
import pytest
from test_library_idioms import simulate

from aero_bayes.errors import InputError
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.expression import Builder, evaluate_nodes
from aero_bayes.modelica.scope import Scope, possible_values
from aero_bayes.modelica.syntax import Assign, Call, Expression, IfStatement, Name, Number, Statement, WhileStatement
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, Outcome, Problem, SolverSettings
from aero_bayes.simulation.model import Model


def test_initial_equations_are_solved_in_their_order(tmp_path):
    """A chain that Newton's method cannot start at zero: each root is there once those before it are known."""
    text = """model Chain
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
"""
    found = simulate(tmp_path, "Chain", text, ["y"], given=16.0)
    rate = 4.0 / 17.0 / 4.0  # share / root
    t = found["time"]
    assert found["y"] == pytest.approx(8.0 + t / rate - (1.0 - np.exp(-rate * t)) / rate**2, abs=1e-7)


def test_initial_equations_without_a_solution_are_an_error(tmp_path):
    text = "model None_\n  Real x;\ninitial equation\n  x ^ 2 = -1;\nequation\n  der(x) = -x;\nend None_;\n"
    (tmp_path / "None_.mo").write_text(text, encoding="utf-8")
    fmu = export_fmu("None_", tmp_path / "n.fmu", sources=[tmp_path / "None_.mo"], compiler="embedded")
    with pytest.raises(Exception, match="fmi2ExitInitializationMode"):
        fmpy.simulate_fmu(str(fmu), stop_time=1.0)


def test_a_linear_loop_whose_result_is_small_against_its_terms(tmp_path):
    """What rounding leaves of terms of 1e9 is far more than the result, which passes zero."""
    text = """model Small
  Real s = if time > 2 then 2 else 0.5;
  Real large = 1e9 * (1 + sin(time));
  Real one(start = 1), two;
  output Real y(start = 0, fixed = true);
equation
  one + s * two = large;
  s * one + two = s * large + cos(10 * time);
  der(y) = two;
end Small;
"""
    found = simulate(tmp_path, "Small", text, ["y"])
    assert found["y"] == pytest.approx(np.sin(10 * found["time"]) / 10 / 0.75, abs=1e-5)


def test_a_loop_across_a_steep_step(tmp_path):
    """A drop before a resistor: full steps of Newton's method go from one side of the step to the other for ever."""
    text = """model Contact
  Real u = 5 * sin(7 * time), i;
  output Real charge(start = 0, fixed = true);
  output Real drop = u - 1000 * i;
equation
  u = 1000 * i + 0.35 * tanh(i / 1e-6);
  der(charge) = i;
end Contact;
"""
    found = simulate(tmp_path, "Contact", text, ["charge", "drop"])
    u = 5.0 * np.sin(7.0 * found["time"])
    outside = np.abs(u) > 0.36
    assert found["drop"][outside] == pytest.approx(0.35 * np.sign(u[outside]), abs=1e-5)
    assert found["drop"][~outside] == pytest.approx(u[~outside], abs=0.02)


def test_two_locked_frictions_share_the_load(tmp_path):
    text = """model Shared
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
"""
    found = simulate(tmp_path, "Shared", text, ["y", "held"])
    free = np.maximum(found["time"] - 0.5, 0.0)
    assert found["y"] == pytest.approx((3 - 0.5 - 0.75) * free, abs=1e-9)
    assert found["held"][:10] == pytest.approx(3.0, abs=1e-9)


def test_locked_parts_that_contradict_each_other_have_no_solution(tmp_path):
    text = """model Torn
  Real v(start = 0, fixed = true), a, one, two;
  Boolean locked = time < 0.5;
equation
  der(v) = a;
  a = 3 - one - two;
  0 = if locked then a else one;
  0 = if locked then a - 1 else two;
end Torn;
"""
    with pytest.raises(Exception, match="fmi2"):
        simulate(tmp_path, "Torn", text, [])


def test_co_simulation_holds_its_tolerance_for_small_states(tmp_path):
    text = """model Flux
  Real x(start = 1e-6, fixed = true), v(start = 0, fixed = true);
  output Real y = 1e6 * x;
equation
  der(x) = v;
  der(v) = -400 * x;
end Flux;
"""
    found = simulate(tmp_path, "Flux", text, ["y"])
    assert found["y"] == pytest.approx(np.cos(20 * found["time"]), abs=1e-4)


def test_a_while_loop_that_a_condition_on_a_variable_ends(tmp_path):
    text = """model Turns
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
"""
    found = simulate(tmp_path, "Turns", text, ["n"])
    rows = np.array([0.12, 0.33, 0.33, 0.71])
    assert found["n"] == pytest.approx((found["time"][:, None] >= rows).sum(axis=1))


def _scope(start: float, condition: Expression, *body: Statement) -> tuple[Builder, Scope]:
    """What a while loop over ``k`` leaves, started at a constant; ``x`` is a variable."""
    b = Builder()
    scope = Scope(b, {}, {"x": b.symbol("x"), "k": b.const(start), "y": b.const(0.0)}, "test")
    scope.run([WhileStatement(condition, body)])
    return b, scope


def _plus_one(name: str) -> Assign:
    return Assign((Name(name),), Call("+", (Name(name), Number(1.0))))


def test_a_while_loop_that_is_left_early():
    """``while k <= 3 loop if x < k then y := k; k := 3; end if; k := k + 1; end while``: the first k above x."""
    leave = (Assign((Name("y"),), Name("k")), Assign((Name("k"),), Number(3.0)))
    early = IfStatement(((Call("<", (Name("x"), Name("k"))), leave),), ())
    b, scope = _scope(1.0, Call("<=", (Name("k"), Number(3.0))), early, _plus_one("k"))
    y = scope.scalar(Name("y"))
    assert [evaluate_nodes([y], {b.symbol("x"): x})[0] for x in (0.5, 1.5, 2.5, 3.5)] == [1.0, 2.0, 3.0, 0.0]


def test_a_while_loop_without_an_end_in_sight_is_refused():
    with pytest.raises(InputError, match=r"while loop"):
        _scope(1.0, Call("<=", (Name("k"), Name("x"))), _plus_one("k"))


def test_choices_are_every_value_that_branches_leave():
    b = Builder()
    c, d = b.symbol("c"), b.symbol("d")
    n = b.select(c, b.const(1.0), b.select(d, b.const(2.0), b.const(5.0)))
    assert possible_values(b, b.add(n, n)) == frozenset(float(i + j) for i in (1, 2, 5) for j in (1, 2, 5))
    assert possible_values(b, b.binary("le", n, b.const(0.5))) == frozenset((0.0,))
    assert possible_values(b, b.binary("and", b.binary("gt", n, b.const(9.0)), c)) == frozenset((0.0,))
    assert possible_values(b, b.add(n, c)) is None
    assert possible_values(b, b.const(math.pi)) == frozenset((math.pi,))


def test_friction_that_comes_to_rest_is_stuck(tmp_path):
    """Sliding backwards under a push that either direction of sliding would answer by turning round."""
    text = """model Rest
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
"""
    found = simulate(tmp_path, "Rest", text, ["y"])
    assert found["y"] == pytest.approx(np.minimum(-2 + 4 * found["time"], 0.0), abs=1e-8)


def test_an_initial_equation_is_about_the_states_that_it_names(tmp_path):
    """Two filters start where a reading is that depends on states that are free: these keep their own starts."""
    text = """model Filters
  Real one(start = 0.6), two(start = 0.25);
  Real fast, slow;
  Real reading = 3 * one - two;
  output Real y = one;
  output Real a = fast;
  output Real b = slow;
initial equation
  fast = reading;
  slow = reading;
equation
  der(one) = -one;
  der(two) = -2 * two;
  der(fast) = 10 * (reading - fast);
  der(slow) = reading - slow;
end Filters;
"""
    found = simulate(tmp_path, "Filters", text, ["y", "a", "b"])
    assert found["y"] == pytest.approx(0.6 * np.exp(-found["time"]), abs=1e-6)
    assert [found["a"][0], found["b"][0]] == pytest.approx([1.55, 1.55], abs=1e-12)


def test_a_root_that_ends_has_no_slope(tmp_path):
    """A tank that runs empty: beyond that its balance has a Jacobian of zero, not of infinity times nothing."""
    text = """model Tank
  Real h(start = 0.1, fixed = true);
  output Real y = h;
equation
  der(h) = -sqrt(max(h, 0)) - 0.01;
end Tank;
"""
    (tmp_path / "Tank.mo").write_text(text, encoding="utf-8")
    model = Model.load(export_fmu("Tank", tmp_path / "tank.fmu", sources=[tmp_path / "Tank.mo"], compiler="embedded"))
    time = np.linspace(0.0, 5.0, 51)
    problem = Problem(model, (Experiment(time, ("y",)),), ((),), settings=SolverSettings(1e-3, 1e-3))
    with open_simulator(problem, workers=0) as simulator:
        found = simulator.simulate(np.empty((1, 0)))
    assert found.outcomes[0, 0] == Outcome.OK
    empty = found.outputs[0][0, :, 0] < -1e-3
    assert empty.sum() > 30
    assert np.diff(found.outputs[0][0, empty, 0]) == pytest.approx(-0.01 * 0.1, rel=0.1)
