"""Formulas: their Modelica says what their numbers are, at every shape, and what is told is what was fitted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.random import Generator
from small_rigs import RIGS, Numbers, explicit, rig
from written_laws import agree

from aero_bayes.export import load_flat
from aero_bayes.language.parse import parse_text
from aero_bayes.language.values import evaluate_expression
from aero_bayes.laws import compose_laws, law_models, ports_with_laws
from aero_bayes.laws.formula import (
    ALONE,
    LOGARITHM_OF_RATIO,
    SIGNAL,
    Formula,
    Shape,
    Signal,
    Way,
    formula_law,
    formulas,
    told,
)
from aero_bayes.laws.formula_places import FormulaPort, parameter_ports
from aero_bayes.laws.law_text import formula
from aero_bayes.laws.placed_law import place_law
from aero_bayes.ports import Port

X, Y, Z = Signal("x", "m", 0.2, 3.0), Signal("y", "s", -2.0, 1.0), Signal("z", "", 0.1, 2.0)
PORT = Port("x", "storage", "equation", "m/s", {"h": "m"}, None)


def placed(one: Formula):
    law, port = formula_law(one, PORT, "formula", 2.0)
    sizes = {f"{name}_n": s.size for name, s in zip(port.signals, one.signals, strict=True)}
    return place_law(law, port, (), nominals={"q_n": 4.0, **sizes})


def test_every_formula_written_in_modelica_is_its_numbers() -> None:
    point = {"x": 0.7, "y": -1.3, "z": 0.4}
    every = list(formulas((X, Y, Z)))
    assert len(every) > 300
    for one in every[::7]:
        law = placed(one)
        values = {name: 1.0 for name in law.names.values()} | {law.names["k"]: 3.0}
        if one.constants:
            values[law.names["a"]] = one.constants[0]
        text = formula(law.law, nominals=law.all_nominals, names={**law.port.signals, **law.names})
        assert text is not None
        wanted = 3.0 * one.values({name: np.array([v]) for name, v in point.items()})[0]
        assert evaluate_expression(parse_text(text), {**point, **values}) == pytest.approx(wanted, rel=1e-6), text


def test_a_coefficient_has_the_unit_that_makes_the_term_right() -> None:
    law = placed(Formula(((SIGNAL, X, 0.0), (SIGNAL, Y, 0.0))))
    assert law.unit(law.law.magnitude) == "1/s2"
    assert law.value(law.law.magnitude) == 0.0


def test_functions_are_offered_only_of_signals_that_they_can_take() -> None:
    texts = {told(one, 1.0, 1.0) for one in formulas((X, Y))}
    assert {"+ 1*x*y", "+ 1*sqrt(x)", "+ 1*y*abs(y)", "+ 1/x"} <= texts
    # a length has no sine, what takes both signs has no root, and what does not needs no absolute value
    assert not {"+ 1*sin(x)", "+ 1*sqrt(y)", "+ 1*abs(x)", "+ 1/y"} & texts
    assert "+ 1*sin(z)" in {told(one, 1.0, 1.0) for one in formulas((Z,))}


def test_a_formula_is_told_with_its_sign_and_constant() -> None:
    saturating = next(s for s in ALONE if s.text == "{s} / ({a} + {s})")
    assert told(Formula(((saturating, X, 0.3),)), -0.31, 0.25) == "- 0.31*(x/(0.25 + x))"
    assert told(Formula(((SIGNAL, X, 0.0), (SIGNAL, Y, 0.0))), 0.314) == "+ 0.314*x*y"


def at_place(model: str, id_: str, one: Formula, own: str = "", *, parameter: bool = False):
    """A formula at a place of a test rig, switched on, and the flat models of its law."""
    flat = rig(model)
    ports = {p.id: FormulaPort(p, 1.0) for p in ports_with_laws(flat, ())}
    ports |= {p.port.id: p for p in parameter_ports(flat, {id_})} if parameter else {}
    law, port = formula_law(one, ports[id_].port, "formula", 1.3, own)
    placed = place_law(law, port, {v.name for v in flat.variables}, values={"k": 0.4})
    return placed, law_models([law])


def product(*names: str) -> Formula:
    return Formula(tuple((SIGNAL, Signal(name, "", 0.1, 2.0), 0.0) for name in names))


@pytest.mark.parametrize(
    ("model", "place", "one", "own"),
    [
        ("Cart", "v", product("x", "F"), "v"),
        ("Cart", "F", product("F", "v"), "F"),
        ("Cart", "q", product("x", "v"), "x"),
        ("Bodies.Pair", "one.port", product("one.T", "P"), "one.T"),
        ("Shaft.Motor", "inductor.p", product("inductor.i", "V"), "inductor.i"),
    ],
)
def test_a_formula_written_at_a_place_is_the_composed_one(
    model: str, place: str, one: Formula, own: str, tmp_path: Path, rng: Generator
) -> None:
    placed, models = at_place(model, place, one, own)
    agree(model, [RIGS / f"{model.partition('.')[0]}.mo"], [placed], models, tmp_path, rng)


@pytest.mark.parametrize(
    ("way", "shape", "factor"),
    [("share", SIGNAL, lambda x: 1.0 + 0.4 * x), ("power", LOGARITHM_OF_RATIO, lambda x: (x / 2.0) ** 0.4)],
)
def test_a_parameter_becomes_a_function(
    way: Way, shape: Shape, factor: Callable[[float], float], tmp_path: Path, rng: Generator
) -> None:
    one = Formula(((shape, Signal("x", "m", 0.1, 2.0), 0.0),), way)
    placed, models = at_place("Cart", "K", one, parameter=True)
    agree("Cart", [RIGS / "Cart.mo"], [placed], models, tmp_path, rng)
    point = {"x": 0.7, "v": 0.3, "F": 1.1}
    found = Numbers(explicit(compose_laws(rig("Cart"), [placed], models)))(point)["der(v)"]
    assert found == pytest.approx((1.1 - 1.5 * 0.3 - 8.0 * factor(0.7) * 0.7) / 2.0, rel=1e-12)


def test_only_parameters_that_nothing_else_is_declared_by_become_functions(tmp_path: Path) -> None:
    text = "model R parameter Real a=1; parameter Real b=2*a; parameter Real c=3; output Real x(start=c);\n"
    (tmp_path / "R.mo").write_text(text + "equation der(x) = -b*x; end R;", encoding="utf-8")
    flat = load_flat("R", [tmp_path / "R.mo"])
    assert [p.port.id for p in parameter_ports(flat, {"a", "b", "c"})] == ["b"]


def test_a_function_of_a_parameter_is_told_with_its_name() -> None:
    q = Signal("q", "", 0.5, 2.5)
    assert told(Formula(((LOGARITHM_OF_RATIO, q, 0.0),), "power"), 0.66, parameter="G") == "G*(q/2.5)^0.66"
    assert told(Formula(((SIGNAL, q, 0.0),), "share"), -0.2, parameter="b") == "b*(1 - 0.2*q)"
