"""Expressions read from text: their values against Python's, their places against the text, their sums and factors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.random import Generator

from aero_bayes.errors import InputError
from aero_bayes.modelica.parse import evaluate_expression, parse_expression, parse_text, tokenize
from aero_bayes.modelica.syntax import (
    Array,
    Call,
    Comprehension,
    If,
    Name,
    NamedArgument,
    Number,
    RangeExpression,
    Text,
    factors,
    names_in,
    short_text,
    summands,
    walk,
)
from aero_bayes.modelica.units import dimension, dimension_of_unit, unit_text

pytestmark = pytest.mark.fast

VALUES = {"a": 1.3, "b": -0.7, "c.d": 2.1, "e": 0.4}
FUNCTIONS = {"sqrt": math.sqrt, "abs": abs, "min": min, "max": max, "exp": math.exp}


def written(rng: Generator, depth: int) -> str:
    """A random expression that Python reads as Modelica does, with blanks and parentheses as it comes."""
    if depth == 0 or rng.random() < 0.2:
        return str(rng.choice([*VALUES, "2", "0.5", "3e-1"]))
    left, right = written(rng, depth - 1), written(rng, depth - 1)
    return str(
        rng.choice([
            f"{left} + {right}", f"{left}-{right}", f"({left}) * {right}", f"({left} - {right})", f"-({left})",
            f"({left}) / (4 + abs({right}))", f"abs({left})^2", f"max({left}, {right})", f"exp(-abs({left}))",
            f"(if {left} < {right} then {left} else {right})",
        ])
    )  # fmt: skip


def by_python(text: str) -> float:
    """The value by Python's own reader."""
    python = text.replace("^", "**").replace("c.d", "c_d")
    while "if " in python:
        begin = python.rindex("if ")
        condition, _, rest = python[begin + 3 :].partition(" then ")
        then, _, rest = rest.partition(" else ")
        depth, end = 0, 0
        while depth >= 0:
            depth += {"(": 1, ")": -1}.get(rest[end], 0)
            end += 1
        python = f"{python[:begin]}({then}) IF ({condition}) ELSE ({rest[: end - 1]}){rest[end - 1 :]}"
    names = {k.replace(".", "_"): v for k, v in VALUES.items()}
    return float(eval(python.replace("IF", "if").replace("ELSE", "else"), {**FUNCTIONS, **names}))


@pytest.mark.parametrize("seed", range(60))
def test_random_expressions_have_the_values_and_places_of_their_text(seed):
    text = written(np.random.default_rng(seed), 4)
    tree = parse_text(text)
    value = by_python(text)
    assert evaluate_expression(tree, VALUES) == pytest.approx(value, rel=1e-12, abs=1e-12)
    assert sum(sign * evaluate_expression(t, VALUES) for sign, t in summands(tree)) == pytest.approx(
        value, rel=1e-9, abs=1e-9
    )
    product = 1.0
    for operator, factor in factors(tree):
        product *= evaluate_expression(factor, VALUES) ** (-1 if operator == "/" else 1)
    assert product == pytest.approx(value, rel=1e-9, abs=1e-9)
    for part in walk(tree):
        begin, end = part.span
        assert parse_text(text[begin:end]) == part


def test_what_modelica_has_beyond_arithmetic():
    x, one = Name("x"), Number(1.0)
    expected = {
        "x[2 + 1, :].y[k]": "x[3,:].y[k]", "a.b.f(x)": "a.b.f(x)", "not a and b or c": "or(and(not(a), b), c)",
        "-x ^ 2": "neg(^(x, 2))", "2 * -x": "*(2, neg(x))", "a .* b ./ c": "./(.*(a, b), c)", "x[end]": "x[end]",
        "der(x) <= 1e-3": "<=(der(x), 0.001)", "'quoted name' + 1": "+('quoted name', 1)",
    }  # fmt: skip
    assert {text: short_text(parse_text(text)) for text in expected} == expected
    assert parse_text("{1, x}") == Array((one, x))
    assert parse_text("[1, x; x, 1]") == Call("[;]", (Call("[,]", (one, x)), Call("[,]", (x, one))))
    assert parse_text("{i * x for i in 1:2:9}") == Comprehension(
        Call("*", (Name("i"), x)), "i", RangeExpression(one, Number(2.0), Number(9.0))
    )
    assert parse_text('f(x, unit = "a" + "b")') == Call(
        "f", (x, NamedArgument("unit", Call("+", (Text("a"), Text("b")))))
    )
    assert parse_text("C(final x = 1)") == Call("C", (NamedArgument("x", one),))
    assert parse_text("if x then 1 elseif true then x else 1") == If(x, one, If(one, x, one))
    assert names_in(parse_expression(tokenize("k * y[k + 1]"), {"k": 2})) == {"y"}
    assert short_text(parse_expression(tokenize("y[k + 1].z"), {"k": 2})) == "y[3].z"


@pytest.mark.parametrize("text", ["", "a +", "(a", "f(a b)", "a b", "if a then b", "{a for}", "x[", "* a", "a = b"])
def test_what_is_no_expression_is_refused(text):
    with pytest.raises(InputError, match=r"cannot read|is missing"):
        parse_text(text)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("m * der(v)", "N"),
        ("m * g - c * v", "N"),
        ("2 * c * v", "N"),
        ("sqrt(v ^ 2)", "m/s"),
        ("(f + c * v) / m", "m/s2"),
        ("abs(f)", "N"),
        ("v < 1", ""),
        ("if v > 0 then f else 0", ""),
    ],
)
def test_units_of_expressions(text, unit):
    units = {"m": "kg", "v": "m/s", "g": "m/s2", "c": "N.s/m", "f": "N"}
    assert unit_text(dimension(parse_text(text), lambda name: dimension_of_unit(units.get(name, "")))) == unit
