"""Small Modelica models: what the embedded exporter translates, and what it refuses by name."""

from __future__ import annotations

import math

import numpy as np
import pytest
from export_driver import driven
from facts import facts

from aero_bayes.errors import InputError
from aero_bayes.modelica.causalisation import ExplicitModel
from aero_bayes.modelica.embedded import explicit_model
from aero_bayes.modelica.expression import evaluate_nodes
from aero_bayes.simulation.model import Model


def values(model: ExplicitModel, at: dict[str, float]) -> dict[str, float]:
    b = model.system.builder
    known = {
        b.symbol(p.name): p.binding.value for p in model.system.parameters if p.binding and p.binding.op == "const"
    }
    known |= {b.symbol(n): v for n, v in at.items()}
    solved = {n: e for n, e in model.solved.items() if not n.startswith("der(")}
    names = [*(f"der({s})" for s in model.states), *solved]
    return dict(zip(names, evaluate_nodes([*model.rates, *solved.values()], known), strict=True))


def test_functions_conditions_and_arithmetic(modelica):
    source = modelica("""within ;
model Mixed
  function bent "a loop, a branch and a table"
    input Real x; input Real c[:]; output Real y;
  protected
    Real a;
  algorithm
    a := 0;
    for i in 1:size(c, 1) loop
      a := a + c[i] * x ^ i;
    end for;
    if x > 0 then y := a; elseif x > -1 then y := -2 * a; else y := 5; end if;
  end bent;
  parameter Real c[3] = {1, -2, 0.5};
  parameter Real k(unit = "N.m", min = 0, max = 3) = 0.5 "gain";
  parameter Real twice = 2 * k;
  input Real u;
  Real x(start = 1, fixed = true), y, z(start = 0.3, fixed = true), w;
equation
  der(x) = -x + u * tanh(y / 0.7) + bent(x, c);
  y = noEvent(if x > 0 then x else -x) + smooth(1, if x > 0.5 then x ^ 2 else x - 0.25) + twice;
  der(z) = min(x, y) - max(z, 0) + sign(x) + abs(z) + sqrt(1 + x ^ 2) + atan2(x, y) + sum(c) * time;
  w = exp(-x) * log(2 + x * x) - sin(x) * cos(z) / cosh(x) + x ^ 3 - (-x) ^ 2 + asin(x / 9) + 2 ^ x;
end Mixed;
""")
    model = explicit_model("Mixed", [source])
    for x in (0.8, -0.4, -1.7, 0.2):
        u, z, t = 1.3, -0.2, 0.9
        found = values(model, {"x": x, "z": z, "u": u, "time": t})
        a = x - 2 * x**2 + 0.5 * x**3
        bent = a if x > 0 else -2 * a if x > -1 else 5.0
        y = abs(x) + (x**2 if x > 0.5 else x - 0.25) + 1.0
        assert found["y"] == pytest.approx(y, rel=1e-14)
        assert found["der(x)"] == pytest.approx(-x + u * math.tanh(y / 0.7) + bent, rel=1e-13)
        sign = (x > 0) - (x < 0)
        rate = min(x, y) - max(z, 0) + sign + abs(z) + math.sqrt(1 + x**2) + math.atan2(x, y) - 0.5 * t
        assert found["der(z)"] == pytest.approx(rate, rel=1e-13)
        w = math.exp(-x) * math.log(2 + x * x) - math.sin(x) * math.cos(z) / math.cosh(x)
        assert found["w"] == pytest.approx(w + x**3 - x**2 + math.asin(x / 9) + 2**x, rel=1e-13)


def test_the_rate_of_an_algebraic_variable(modelica):
    source = modelica("""within ;
model Rate
  Real x(start = 1, fixed = true), F, y(start = 0, fixed = true);
equation
  der(x) = -2 * x; F = x ^ 3; der(y) = der(F);
end Rate;
""")
    model = explicit_model("Rate", [source])
    assert set(model.states) == {"x", "y"}
    assert values(model, {"x": 0.5, "y": 0.0})["der(y)"] == pytest.approx(3 * 0.25 * -1.0)


def test_a_model_without_states(exported):
    path = exported(
        "within ;\nmodel Static\n  input Real u; parameter Real a = 3; output Real y = a * u ^ 2;\nend Static;\n"
    )
    with driven(path) as fmu:
        fmu.begin()
        fmu.set(u=2.0, a=5.0)
        assert fmu.get("y")[0] == 20.0
        assert fmu.slope(["y"], "u")[0] == 20.0
        assert fmu.slope(["y"], "a")[0] == 4.0


def test_start_values_follow_parameters_and_initial_equations(exported):
    path = exported("""within ;
model Starts
  parameter Real a = 2; parameter Real both = 3 * a;
  Real x(start = a + 1, fixed = true), z(start = 9);
initial equation
  der(z) = 0;
equation
  der(x) = -both * x; der(z) = 4 * x - a * z;
end Starts;
""")
    with driven(path) as fmu:
        fmu.set(a=5.0)
        fmu.begin()
        assert fmu.get("both")[0] == 15.0
        assert fmu.get("x", "z") == pytest.approx([6.0, 4 * 6.0 / 5.0])
        fmu.fmu.reset()
        fmu.set(a=5.0, x=1.5)
        fmu.begin()
        assert fmu.get("x", "z") == pytest.approx([1.5, 4 * 1.5 / 5.0])


def test_inner_parameters_are_shown_only_where_they_act(exported):
    path = exported("""within ;
model Inner
  input Real u(unit = "N.m");
  Aero.Mechanical.Torque drive(tau = u);
  Aero.Mechanical.PitchingBody body(J_p = 2);
  parameter Real unused = 1;
  parameter Boolean flag = true;
equation
  connect(drive.flange, body.flange);
end Inner;
""")
    with driven(path) as fmu:
        assert set(fmu.parameters) == {"unused", "body.J_p", "body.D_p", "body.K_sp"}
        fmu.begin()
        fmu.set_all({"u": 3.0, "body.J_p": 6.0, "body.D_p": 0.0, "body.K_sp": 0.0})
        rates = dict(zip(fmu.states, fmu.rhs(np.zeros(2)), strict=True))
        assert rates["body.omega"] == pytest.approx(0.5)


MODEL = "within ;\nmodel Bad\n  Real x(start = 1, fixed = true); Real y;\nequation\n  der(x) = -x;\n{}\nend Bad;\n"

REFUSED = [
    ("  y = sample(0, 1);", r"^Bad\.mo:2: Bad: "),
    ("  y = delay(x, 0.1);", r"^Bad\.mo:6: .*'delay'"),
    ("  der(2 * x) = y;", "derivative"),
    ("  y = foo(x);", r"^Bad\.mo:6: .*'foo'"),
    ('  y = 1;\n  when x < 0.1 then\n    terminate("done");\n  end when;', r"^Bad\.mo:\d+: .*terminate"),
    ("  0 = x ^ 2 + y ^ 2 - 1;\n  der(y) = -y;", "^Bad"),
    ("  y = String(x) + 1;", "^Bad"),
    ("  y = x +;", r"^Bad\.mo:6: unexpected `;`$"),
    ('  y = "one";', r"^Bad\.mo:6: type mismatch"),
    ("", r"^Bad\.mo:3: Bad: 1 equations for 2 unknowns: .* y$"),
    ("  y = 1;\n  y = 2;", r"^Bad\.mo:7: Bad: 3 equations for 2 unknowns: too many equations determine y$"),
    ("  y = q;", r"^Bad\.mo:6: .*'q'"),
    ("  0 = x - 2 * x;", "structurally singular"),
    ("  y = log(-1);", "log"),
    ("  y = x / 0;", r"^Bad\.mo:6: .*division by zero"),
    ("  y = x * log(time - time);", r"^Bad\.mo:6: .*log"),
    ("  y = sum(x for i in 1:1000000);", r"^Bad\.mo:6: .*1000000 elements; at most 100000"),
    (f"  y = x{' + 2 * x' * 600};", r"^Bad\.mo:6: Bad: an expression of very many operands is too long"),
    (f"  y = x{' + 2 * x' * 20_000};", r"^Bad\.mo:6: Bad: an expression of very many operands is too long"),
]


@pytest.mark.parametrize(("line", "message"), REFUSED)
def test_what_cannot_be_translated_is_named(line, message, modelica):
    source = modelica(MODEL.format(line), "Bad")
    with pytest.raises(InputError, match=message) as caught:
        explicit_model("Bad", [source])
    assert "\n" not in str(caught.value)
    assert "/tmp" not in str(caught.value)


def test_a_slip_inside_a_package_has_its_line_too(modelica):
    source = modelica(f"package Kit\n{MODEL.format('  y = x').removeprefix('within ;')}end Kit;\n", "Kit")
    with pytest.raises(InputError, match=r"^Kit\.mo:8: unexpected `end`; .* line 7\?$"):
        explicit_model("Kit.Bad", [source])


def test_modifiers_that_the_front_end_would_drop_are_refused(modelica):
    source = modelica("""within ;
model Dropped
  parameter Real k_0 = 1e-3;
  extends Aero.Systems.OneDof(
    redeclare model ThrustLaw = Aero.Aerodynamics.LinearThrust(k = k_0));
end Dropped;
""")
    with pytest.raises(InputError, match=r"Dropped\.mo:5: .*'ThrustLaw'"):
        explicit_model("Dropped", [source])


def test_unknown_models_and_files_are_named(tmp_path):
    with pytest.raises(InputError, match="Nothing"):
        explicit_model("Aero.Systems.Nothing")
    with pytest.raises(InputError, match=facts("missing.mo")):
        explicit_model("Missing", [tmp_path / "missing.mo"])
    with pytest.raises(InputError, match=facts("Aero; quit()")):
        explicit_model("Aero; quit()")


def test_an_output_may_be_a_state_itself(exported):
    text = "model Tank\n  input Real u;\n  output Real q(start = 2);\nequation\n  der(q) = u - q;\nend Tank;\n"
    built = Model.load(exported(text))
    assert [v.name for v in built.outputs] == ["q"]
    assert [s.name for s in built.states] == ["q"]
