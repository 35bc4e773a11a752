"""The expression graph against complex steps, differences and IEEE arithmetic."""

from __future__ import annotations

import math

import pytest

from aero_bayes.modelica.expression import Builder, Node, evaluate_nodes
from aero_bayes.modelica.parse import BINARY, UNARY

pytestmark = pytest.mark.fast

SMOOTH = ["sqrt", "exp", "log", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "abs"]


@pytest.mark.parametrize("op", SMOOTH)
def test_derivative_of_a_function(op):
    b = Builder()
    x = b.symbol("x")
    node = b.unary(op, b.mul(x, b.const(0.7)))
    slope = b.derivative(node, x)
    for at in (0.31, 0.9) if op in ("sqrt", "log", "log10") else (-0.62, 0.31, 0.9):
        h = 1e-6
        expected = (UNARY[op](0.7 * (at + h)) - UNARY[op](0.7 * (at - h))) / (2 * h)
        assert evaluate_nodes([slope], {x: at})[0] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("op", ["add", "sub", "mul", "div", "pow", "min", "max", "atan2"])
def test_derivatives_of_an_operation(op):
    b = Builder()
    x, y = b.symbol("x"), b.symbol("y")
    node = b.binary(op, b.mul(x, x), b.add(y, b.one))
    for symbol in (x, y):
        slope = b.derivative(node, symbol)
        at = {x: 0.8, y: 1.3}
        ends = []
        for sign in (1, -1):
            moved = at | {symbol: at[symbol] + sign * 1e-6}
            ends.append(BINARY[op](moved[x] ** 2, moved[y] + 1))
        assert evaluate_nodes([slope], at)[0] == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("power", [-2.0, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 2.5])
def test_constant_powers(power):
    b = Builder()
    x = b.symbol("x")
    node = b.binary("pow", x, b.const(power))
    assert evaluate_nodes([node], {x: 1.7})[0] == pytest.approx(1.7**power, rel=1e-15)
    assert evaluate_nodes([b.derivative(node, x)], {x: 1.7})[0] == pytest.approx(power * 1.7 ** (power - 1), rel=1e-14)


def test_the_branch_not_taken_cannot_spoil_a_derivative():
    b = Builder()
    x = b.symbol("x")
    node = b.select(b.binary("gt", x, b.zero), b.unary("sqrt", x), b.zero)
    assert evaluate_nodes([node, b.derivative(node, x)], {x: -1.0}) == [0.0, 0.0]
    assert evaluate_nodes([b.derivative(node, x)], {x: 4.0}) == [0.25]


def test_a_root_of_what_does_not_change_has_no_slope():
    b = Builder()
    x = b.symbol("x")
    slope = b.derivative(b.unary("sqrt", b.binary("max", x, b.zero)), x)
    assert [evaluate_nodes([slope], {x: at})[0] for at in (-1.0, 4.0)] == [0.0, 0.25]


def test_equal_expressions_are_one_node():
    b = Builder()
    x, y = b.symbol("x"), b.symbol("y")
    assert b.add(b.mul(x, y), x) is b.add(x, b.mul(y, x))
    assert b.sub(x, x) is b.zero
    assert b.mul(x, b.zero) is b.zero
    assert b.neg(b.neg(x)) is x
    assert b.const(-0.0) is b.zero
    assert b.div(b.neg(x), y) is b.neg(b.div(x, y))


def test_simplification_keeps_the_value():
    import numpy as np

    rng = np.random.default_rng(7)
    for _ in range(200):
        b = Builder()
        symbols = [b.symbol(n) for n in "xyz"]
        pool: list[Node] = [*symbols, b.zero, b.one, b.const(-1.0), b.const(2.0)]
        at = dict(zip(symbols, rng.normal(size=3), strict=True))
        numbers = [*at.values(), 0.0, 1.0, -1.0, 2.0]
        for _ in range(12):
            op = str(rng.choice(["add", "sub", "mul", "neg"]))
            i, j = (int(k) for k in rng.integers(len(pool), size=2))
            node = b.neg(pool[i]) if op == "neg" else b.binary(op, pool[i], pool[j])
            value = -numbers[i] if op == "neg" else BINARY[op](numbers[i], numbers[j])
            pool.append(node)
            numbers.append(float(value))
        for node, number in zip(pool, numbers, strict=True):
            assert evaluate_nodes([node], at)[0] == pytest.approx(number, rel=1e-9, abs=1e-9)


def test_a_constant_out_of_range_is_an_error():
    b = Builder()
    with pytest.raises(ValueError, match="domain"):
        b.unary("log", b.const(-1.0))
    with pytest.raises(ZeroDivisionError):
        b.div(b.one, b.zero)
    assert math.isinf(evaluate_nodes([b.const(math.inf)], {})[0])
