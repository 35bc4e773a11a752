"""Initial equations, loops and algorithms that need care, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_closed_forms import simulated

from aero_bayes.errors import InputError
from aero_bayes.modelica.expression import Builder, evaluate_nodes
from aero_bayes.modelica.scope import Scope, possible_values
from aero_bayes.modelica.syntax import Assign, Call, Expression, IfStatement, Name, Number, Statement, WhileStatement
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, Outcome, Problem, SolverSettings
from aero_bayes.simulation.model import Model


def test_initial_equations_without_a_solution_are_an_error(exported):
    text = "model None_\n  Real x;\ninitial equation\n  x ^ 2 = -1;\nequation\n  der(x) = -x;\nend None_;\n"
    with pytest.raises(Exception, match="fmi2ExitInitializationMode"):
        simulated(exported(text), "CoSimulation", 1.0, [])


def test_locked_parts_that_contradict_each_other_have_no_solution(exported):
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
        simulated(exported(text), "CoSimulation", 1.0, [])


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


def test_a_root_that_ends_has_no_slope(exported):
    """A tank that runs empty: beyond that its balance has a Jacobian of zero, not of infinity times nothing."""
    text = """model Tank
  Real h(start = 0.1, fixed = true);
  output Real y = h;
equation
  der(h) = -sqrt(max(h, 0)) - 0.01;
end Tank;
"""
    time = np.linspace(0.0, 5.0, 51)
    problem = Problem(
        Model.load(exported(text)), (Experiment(time, ("y",)),), ((),), settings=SolverSettings(1e-3, 1e-3)
    )
    with open_simulator(problem, workers=0) as simulator:
        found = simulator.simulate(np.empty((1, 0)))
    assert found.outcomes[0, 0] == Outcome.OK
    empty = found.outputs[0][0, :, 0] < -1e-3
    assert empty.sum() > 30
    assert np.diff(found.outputs[0][0, empty, 0]) == pytest.approx(-0.01 * 0.1, rel=0.1)
