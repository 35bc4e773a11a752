"""Arrays, records, loops, branches and functions with algorithms, against the same in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from export_driver import driven

from aero_bayes.modelica.compilers import export_fmu

SOURCE = """within ;
package Shapes
  record Point
    Real a;
    Real b[2];
  end Point;
  type Kind = enumeration(Small, Large);
  function horner "value and slope"
    input Real x;
    input Real c[:];
    output Real y = 0;
    output Real dy = 0;
  algorithm
    for i in size(c, 1):-1:1 loop
      dy := dy * x + y;
      y := y * x + c[i];
    end for;
  end horner;
  function shifted
    input Real v[:];
    input Integer by = 2;
    output Real w[size(v, 1)];
  algorithm
    for i in 1:size(v, 1) loop
      w[i] := v[size(v, 1) + 1 - i] * by;
    end for;
    if w[1] > 0 then
      w[1] := 2 * w[1];
    elseif w[2] > 0 then
      w[2] := 3 * w[2];
    else
      w := -w;
    end if;
  end shifted;
  function turned
    input Point p;
    output Point q;
  algorithm
    q.a := p.b[1];
    q.b := {p.a, 2 * p.b[2]};
  end turned;
  model Chain
    parameter Integer n = 6;
    parameter Real k[n] = {1, 2, 3, 4, 5, 6};
    parameter Kind kind = Kind.Large;
    parameter Boolean heavy = kind == Kind.Large;
    parameter Real m[2, 2] = [1, 2; 3, 4];
    input Real u;
    Real x[n](each start = 1, each fixed = true);
    Point p, q, t;
    Real slope, both[2, 3], v[3];
    output Real first, second, third, fourth;
  equation
    der(x[1]) = u - k[1] * x[1];
    for i in 2:n loop
      der(x[i]) = k[i] * (x[i - 1] - x[i]);
    end for;
    p = Point(x[1], {x[2], x[3]});
    q.a = p.a + p.b[2];
    q.b = m * p.b;
    (first, slope) = horner(x[1], {1, 2, 3});
    t = turned(p);
    both = [p.b, m];
    v = shifted({x[1], -x[2], x[3]});
    second = slope + sum(q.b) + q.a + t.a + 5 * t.b[2];
    if heavy then
      third = sum(both[1, :]) + v * {1, 10, 100};
    else
      third = 0;
    end if;
    fourth = max(x) + product(k[2:3]) + sum(i ^ 2 * x[i] for i in 1:n);
  end Chain;
end Shapes;
"""


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_chain_of_arrays_records_and_functions(sign, modelica, tmp_path):
    path = export_fmu("Shapes.Chain", tmp_path / "c.fmu", compiler="embedded", sources=[modelica(SOURCE)])
    x = sign * np.array([0.7, -0.4, 1.3, 0.2, -1.1, 0.5])
    k = np.arange(1.0, 7.0)
    m = np.array([[1.0, 2.0], [3.0, 4.0]])
    with driven(path) as fmu:
        fmu.begin()
        fmu.set(u=0.3)
        rates = dict(zip(fmu.states, fmu.rhs(np.array([x[int(s[2]) - 1] for s in fmu.states])), strict=True))
        before = np.r_[0.0, x[:-1]]
        expected = np.where(np.arange(6) == 0, 0.3 - x, k * (before - x))
        assert [rates[f"x[{i}]"] for i in range(1, 7)] == pytest.approx(expected)
        w = 2 * np.array([x[2], -x[1], x[0]])
        if w[0] > 0:
            w[0] *= 2
        elif w[1] > 0:
            w[1] *= 3
        else:
            w = -w
        b = x[1:3]
        assert fmu.get("first")[0] == pytest.approx(1 + 2 * x[0] + 3 * x[0] ** 2)
        assert fmu.get("second")[0] == pytest.approx(2 + 6 * x[0] + (m @ b).sum() + x[0] + x[2] + b[0] + 10 * b[1])
        assert fmu.get("third")[0] == pytest.approx(b[0] + m[0].sum() + w @ [1, 10, 100])
        assert fmu.get("fourth")[0] == pytest.approx(x.max() + 6 + (np.arange(1, 7) ** 2 * x).sum())


def test_two_flywheels_behind_a_rigid_gear_have_one_speed(exported):
    # index three: three equations tie angles, speeds and accelerations; closed form of the reduced model
    path = exported("""within ;
model Geared
  parameter Real r = 3, J_1 = 0.1, J_2 = 0.5, d = 0.2;
  Real phi_1(start = 0, fixed = true), w_1(start = 6, fixed = true), a_1, tau_1;
  Real phi_2, w_2, a_2, tau_2;
  output Real y;
equation
  der(phi_1) = w_1;
  der(w_1) = a_1;
  J_1 * a_1 = tau_1;
  der(phi_2) = w_2;
  der(w_2) = a_2;
  J_2 * a_2 = tau_2 - d * w_2;
  phi_1 = r * phi_2;
  0 = r * tau_1 + tau_2;
  y = phi_2;
end Geared;
""")
    with driven(path) as fmu:
        assert len(fmu.states) == 2
        fmu.begin()
        at = dict(zip(fmu.states, fmu.position(), strict=True))
        slow = {"phi_1": 3.0, "w_1": 3.0, "y": 1.0, "phi_2": 1.0, "w_2": 1.0}
        speed = next(n for n in at if n.startswith("w_"))
        assert at[speed] / slow[speed] == pytest.approx(2.0)
        rates = dict(zip(fmu.states, fmu.rhs(np.array([at[s] for s in fmu.states])), strict=True))
        # (J_2 + r^2 J_1) dw_2 = -d w_2
        assert rates[speed] / slow[speed] == pytest.approx(-0.2 * 2.0 / (0.5 + 9 * 0.1))
