"""What the standard library's blocks rely on, against closed forms and NumPy's interpolation."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from aero_bayes.modelica.arrays import Value
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.expression import Builder, Node, evaluate_nodes
from aero_bayes.modelica.operators import Events, call_table

FloatArray = NDArray[np.float64]
TYPES, INTERNAL = "Modelica.Blocks.Types.", "Modelica.Blocks.Tables.Internal."
LINES, STEPS = 1.0, 3.0
HOLD, LAST_TWO, PERIODIC = 1.0, 2.0, 3.0


def simulate(folder: Path, name: str, text: str, outputs: list[str], **start: float) -> dict[str, FloatArray]:
    source = folder / f"{name}.mo"
    source.write_text(text)
    fmu = export_fmu(name, folder / f"{name}.fmu", sources=[source], compiler="embedded")
    found = fmpy.simulate_fmu(
        str(fmu), fmi_type="CoSimulation", stop_time=1.0, output_interval=0.05, relative_tolerance=1e-9,
        output=outputs, start_values=start,
    )  # fmt: skip
    return {n: found[n] for n in ("time", *outputs)}


def test_what_a_continuous_variable_was_until_the_event(tmp_path):
    """``pre`` of an algebraic variable is its left limit: of what jumps in the same event, the old value."""
    text = """model Held
  discrete Real a(start = 0, fixed = true);
  Real u = a + time;
  output Real y(start = 0, fixed = true);
equation
  when sample(0.1, 0.1) then
    a = pre(a) + 1;
    y = pre(u);
  end when;
end Held;
"""
    found = simulate(tmp_path, "Held", text, ["y"])
    ticks = np.floor(found["time"] / 0.1 + 1e-9)
    assert found["y"] == pytest.approx(np.maximum(ticks - 1.0, 0.0) + 0.1 * ticks, abs=1e-9)


def test_an_event_at_the_end_of_a_step_belongs_to_it(tmp_path):
    text = "model Late\n  output Real y = if time < 0.5 then 0 else 1;\nend Late;\n"
    found = simulate(tmp_path, "Late", text, ["y"])
    assert found["y"] == pytest.approx((found["time"] >= 0.5 - 1e-9).astype(float))


def test_parameters_that_initial_equations_determine(tmp_path):
    """p^3 + p = 10 a, x' = -p x."""
    text = """model Solved
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
    for a in (3.0, 1.0):
        p = float(np.roots([1.0, 0.0, 1.0, -10.0 * a]).real.max())
        found = simulate(tmp_path, "Solved", text, ["x", "y"], a=a)
        assert found["x"] == pytest.approx(np.exp(-p * found["time"]), abs=1e-7)
        assert found["y"] == pytest.approx(2.0 * p, abs=1e-9)


def test_a_start_that_depends_on_an_input_and_on_a_branch(tmp_path):
    text = """model Start
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
"""
    found = simulate(tmp_path, "Start", text, ["x", "z"], u=4.0)
    assert found["x"] == pytest.approx(4.0, abs=1e-9)
    assert found["z"] == pytest.approx(12.0 * np.exp(-found["time"]), abs=1e-7)


def value(b: Builder, function: str, table: Value, *args: float, events: Events | None = None) -> float:
    found = call_table(b, INTERNAL + function, [table, *map(b.const, args)], events)
    assert isinstance(found, Node)
    return evaluate_nodes([found], {})[0]


def rows(b: Builder, table: list[list[float]]) -> Value:
    return [[b.const(v) for v in row] for row in table]


@pytest.mark.parametrize("beyond", [HOLD, LAST_TWO, PERIODIC])
def test_a_table_over_time(beyond):
    b = Builder()
    x, y = np.array([0.0, 1.0, 2.5]), np.array([1.0, 3.0, -1.0])
    args = ["NoName", "NoName", rows(b, np.column_stack([x, 0 * y, y]).tolist()), b.const(0.2), [b.const(3.0)],
            *map(b.const, (LINES, beyond, 0.1, 1.0))]  # fmt: skip
    table = call_table(b, f"{TYPES}ExternalCombiTimeTable", args)
    assert table is not None
    for t in (0.1, 0.3, 1.05, 1.9, 2.8, 4.2):
        u = t - 0.1
        inside = np.interp(u % 2.5 if beyond == PERIODIC else u, x, y)
        line = y[-1] + (y[-1] - y[-2]) / 1.5 * (u - x[-1])
        expected = line if beyond == LAST_TWO and u > x[-1] else inside
        assert value(b, "getTimeTableValueNoDer2", table, 1.0, t, 0.0, 0.0) == pytest.approx(
            0.0 if t < 0.2 else expected
        )


def test_a_table_over_two_inputs():
    b = Builder()
    x, z = np.array([0.0, 1.0, 3.0]), np.array([-1.0, 2.0])
    inner = np.array([[1.0, 4.0], [2.0, -3.0], [5.0, 0.5]])
    whole = np.block([[np.zeros((1, 1)), z[None, :]], [x[:, None], inner]])
    args = ["NoName", "NoName", rows(b, whole.tolist()), b.const(LINES), b.const(LAST_TWO)]
    table = call_table(b, f"{TYPES}ExternalCombiTable2D", args)
    assert table is not None
    exact = RegularGridInterpolator((x, z), inner)
    for point in ((0.2, 0.0), (2.0, 1.9), (1.0, -1.0), (2.9, 0.3)):
        assert value(b, "getTable2DValue", table, *point) == pytest.approx(float(exact(np.array([point]))[0]))


def test_steps_hold_until_the_next_row():
    b = Builder()
    args = ["NoName", "NoName", rows(b, [[0.0, 1.0], [1.0, 2.0], [2.0, 5.0]]), [b.const(2.0)],
            b.const(STEPS), b.const(HOLD)]  # fmt: skip
    table = call_table(b, f"{TYPES}ExternalCombiTable1D", args)
    assert table is not None
    assert [value(b, "getTable1DValueNoDer", table, 1.0, u) for u in (-1.0, 0.5, 1.5, 2.5)] == [1.0, 1.0, 2.0, 5.0]


def test_a_loop_without_a_solution_on_the_other_branch(tmp_path):
    """What flows out has the enthalpy that flows in; on the branch of reverse flow the equation says nothing of it."""
    text = """model Outflow
  parameter Real q_0 = 0.1;
  Real q = q_0 * (1 + time);
  Real h, port;
  output Real T(start = 1, fixed = true);
equation
  semiLinear(-q, port, h) = -q * 5;
  semiLinear(-q, port, h) + semiLinear(q, port, T) = 0;
  der(T) = port - T;
end Outflow;
"""
    found = simulate(tmp_path, "Outflow", text, ["T"])
    assert found["T"] == pytest.approx(5.0 - 4.0 * np.exp(-found["time"]), abs=1e-7)


def test_an_algorithm_that_makes_its_own_events(tmp_path):
    """A function with several results in a when clause of an algorithm, its arguments the values before."""
    text = """model Own
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
"""
    found = simulate(tmp_path, "Own", text, ["y"])
    # the first event is that of initial(), which moves the instant too
    ticks = np.searchsorted([0.625, 0.925], found["time"], side="right")
    due = np.array([0.0, 0.625, 0.925])[ticks]
    assert found["y"] == pytest.approx(2.0 * due + 100.0 * (ticks + 1.0), abs=1e-6)
