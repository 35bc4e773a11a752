"""Formulas: their Modelica says what their numbers are, at every shape, and what is told is what was fitted."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.language.parse import parse_text
from aero_bayes.language.values import evaluate_expression
from aero_bayes.laws.formula import ALONE, SIGNAL, Formula, Signal, formula_law, formulas, told
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
