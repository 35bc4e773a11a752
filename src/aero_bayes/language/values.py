"""The functions and operators of Modelica on numbers, and the value of an expression."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from aero_bayes.errors import InputError
from aero_bayes.language.syntax import Call, Expression, If, Name, Number, short_text

UNARY: dict[str, Callable[[float], float]] = {
    "sqrt": math.sqrt,
    "exp": math.exp,
    "log": math.log,
    "log10": math.log10,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "asin": math.asin,
    "acos": math.acos,
    "atan": math.atan,
    "sinh": math.sinh,
    "cosh": math.cosh,
    "tanh": math.tanh,
    "abs": abs,
    "sign": lambda x: float((x > 0) - (x < 0)),
    "neg": lambda x: -x,
    "not": lambda x: float(not x),
    "floor": lambda x: float(math.floor(x)),
}

BINARY: dict[str, Callable[[float, float], float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "pow": lambda a, b: float(a**b),
    "min": min,
    "max": max,
    "atan2": math.atan2,
    "lt": lambda a, b: float(a < b),
    "le": lambda a, b: float(a <= b),
    "gt": lambda a, b: float(a > b),
    "ge": lambda a, b: float(a >= b),
    "eq": lambda a, b: float(a == b),
    "ne": lambda a, b: float(a != b),
    "and": lambda a, b: float(bool(a) and bool(b)),
    "or": lambda a, b: float(bool(a) or bool(b)),
}

RELATIONS = frozenset({"lt", "le", "gt", "ge", "eq", "ne"})
BOOLEAN = RELATIONS | {"and", "or", "not"}
#: The operators of the language by the functions above.
OPERATORS = {
    "+": "add", "-": "sub", "*": "mul", "/": "div", "^": "pow",
    ".+": "add", ".-": "sub", ".*": "mul", "./": "div", ".^": "pow",
    "<": "lt", "<=": "le", ">": "gt", ">=": "ge", "==": "eq", "<>": "ne",
    "and": "and", "or": "or", "min": "min", "max": "max", "atan2": "atan2",
}  # fmt: skip


def evaluate_expression(tree: Expression, values: Mapping[str, float]) -> float:
    """Return the number of an expression. Raises InputError for a name without a value, or what has no number."""
    match tree:
        case Number(value):
            return value
        case Name():
            name = short_text(tree)
            if name not in values:
                raise InputError(f"{name!r} has no value here")
            return values[name]
        case If(condition, then, otherwise):
            return evaluate_expression(then if evaluate_expression(condition, values) else otherwise, values)
        case Call(function, (one,)) if function in UNARY:
            return float(UNARY[function](evaluate_expression(one, values)))
        case Call(function, (one, two)) if (operation := OPERATORS.get(function, "")) in BINARY:
            return float(BINARY[operation](evaluate_expression(one, values), evaluate_expression(two, values)))
    raise InputError(f"{short_text(tree)} is not a plain formula in sizes")
