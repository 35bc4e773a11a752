"""Assertions and beginnings of exported models, against closed forms."""

from __future__ import annotations

from math import log

import fmpy
import numpy as np
import pytest
from export_driver import driven
from test_closed_forms import simulated


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
