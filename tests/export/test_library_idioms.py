"""The tables of the standard library's blocks, against NumPy's and SciPy's interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from aero_bayes.modelica.array_values import Value
from aero_bayes.modelica.expression import Builder, Node, evaluate_nodes
from aero_bayes.modelica.operators import Events, call_table

TYPES, INTERNAL = "Modelica.Blocks.Types.", "Modelica.Blocks.Tables.Internal."
LINES, STEPS = 1.0, 3.0
HOLD, LAST_TWO, PERIODIC = 1.0, 2.0, 3.0


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
