"""Flat models that are changed without a compiler, against formulas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest
from export_driver import driven
from hand_written_aero import NOMINAL, SCALES, one_dof

from aero_bayes.errors import InputError
from aero_bayes.modelica.compose import (
    add_input,
    add_output,
    add_term,
    attribute_value,
    replace_uses,
    set_parameter,
)
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Call, Name, Number, names_in

Write = Callable[..., Path]


@pytest.fixture(scope="module")
def base() -> FlatModel:
    return load_flat("Aero.Systems.OneDof")


def test_the_flat_model_says_where_everything_comes_from(base):
    resistance = base.variable("R_a")
    assert (resistance.unit, resistance.variability, resistance.place and resistance.place.file) == (
        "Ohm", "parameter", "Aero/Systems/Bench.mo",
    )  # fmt: skip
    assert base.variable("body.flange.tau").flow
    assert base.variable("V_m").causality == "input"
    assert not base.variable("body.flange.w").flow
    place = next(e.place for e in base.equations if {"body.J_p", "body.omega"} <= names_in(e.left) | names_in(e.right))
    assert place is not None
    assert place.file == "Aero/Mechanical/PitchingBody.mo"
    source = Path("modelica", place.file)
    root = next(p for p in Path(__file__).parents if (p / source).is_file())
    text = (root / source).read_bytes()
    assert b"=" in text[place.start : place.end]
    assert text[: place.start].count(b"\n") + 1 == place.line
    kinds = {e.origin for e in base.equations}
    assert kinds == {"component", "connection", "flow", "binding"}
    shared = next(e for e in base.equations if e.origin == "flow" and "body.flange.tau" in names_in(e.left))
    assert {"arm_1.flange.tau", "body.flange.tau", "arm_2.flange.tau"} == names_in(shared.left)


def test_uses_of_an_input_pass_through_a_law(base, tmp_path):
    flat = replace_uses(replace(base, name="Gained"), "V_m", Call("*", (Number(0.25), Name("V_m"))))
    flat = add_input(flat, "push", "N.m")
    flow = next(k for k, e in enumerate(flat.equations) if e.origin == "flow" and "body.flange.tau" in names_in(e.left))
    flat = add_term(flat, flow, Call("neg", (Name("push"),)))
    flat = add_output(flat, "speed_2", Name("body.omega"), "rad/s")
    x = dict(zip(SCALES, (0.2, 310.0, 0.3, 0.7, -0.1, -290.0), strict=True))
    with driven(export_flat(flat, tmp_path / "g.fmu")) as fmu:
        fmu.begin()
        fmu.set(V_m=12.0, push=0.03)
        at = x | {"speed_2": x["body.omega"]}
        found = dict(zip(fmu.states, fmu.rhs(np.array([at[s] for s in fmu.states])), strict=True))
        rates = one_dof(x, 3.0, NOMINAL)
        rates["body.omega"] += 0.03 / NOMINAL["J_p"]
        names = {"speed_2": "body.omega"}
        assert fmu.get("speed_2")[0] == 0.7
        for name, rate in found.items():
            assert rate == pytest.approx(rates[names.get(name, name)], rel=1e-12), name


def test_attributes_are_evaluated_over_parameters(modelica: Write):
    law = load_flat(
        "Sized",
        [
            modelica("""model Sized
  parameter Real f_n = 2;
  parameter Real v_s = 0.5;
  parameter Real F_c(min = 0, max = 10 * f_n, nominal = 0.1 * f_n) = 1e-3;
  parameter Real table[3] = {1, 2, 4};
  Real z(start = 0.25, fixed = true);
equation
  der(z) = -z;
end Sized;
""")
        ],
    )
    assert attribute_value(law, "F_c", "max") == 20.0
    assert attribute_value(law, "F_c", "max", {"f_n": 0.5}) == 5.0
    assert attribute_value(law, "F_c", "nominal", {"f_n": 0.5}) == pytest.approx(0.05)
    assert attribute_value(law, "F_c", "value") == 1e-3
    assert attribute_value(law, "v_s", "max") == inf
    assert attribute_value(law, "z", "start") == 0.25
    assert attribute_value(law, "table[3]", "value") == 4.0


def test_what_does_not_fit_is_refused(base):
    with pytest.raises(InputError, match="no parameter 'theta'"):
        set_parameter(base, "theta", 1.0)
    with pytest.raises(InputError, match="no variable 'nothing'"):
        attribute_value(base, "nothing", "max")
    with pytest.raises(InputError, match="'R_a' already"):
        add_input(base, "R_a")
