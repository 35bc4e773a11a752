"""What a user would try instead: SINDy and symbolic regression on what the first model leaves of the derivatives."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import least_squares

from odebench_tasks.recordings import times, trajectory
from odebench_tasks.systems import Task
from odebench_tasks.verdict import is_term

FloatArray = NDArray[np.float64]


def peers(task: Task, readings: FloatArray) -> dict[str, str]:
    """Return the verdict on each method that is installed, all states given.

    The readings are smoothed and differentiated by splines, the constants of the first model are fitted to the
    derivatives, and each method explains what is left of each rate. Both are told in which rate a term is missing.
    """
    assert task.term is not None
    smooth, residual = _residual(task, readings)
    clean = trajectory(task.system, task.system.starts[0])
    assert clean is not None
    found = {}
    methods: dict[str, Callable[[FloatArray, FloatArray, FloatArray], FloatArray]] = {
        "sindy": _sindy, "gplearn": _gplearn
    }  # fmt: skip
    for name, method in methods.items():
        if importlib.util.find_spec("pysindy" if name == "sindy" else name) is None:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                values = method(smooth, residual, clean)
            except (ValueError, ArithmeticError, np.linalg.LinAlgError):
                values = np.zeros(len(clean))
        where = task.system.states[task.term.state]
        silent = not np.any(np.isfinite(values)) or not np.any(values)
        found[name] = "silent" if silent else "right" if is_term(task, {where: values}, clean) else "false"
    return found


def _residual(task: Task, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute smoothed states (n, s), and what the first model leaves of the rate (n,) that lacks a term."""
    assert task.term is not None
    splines = [make_smoothing_spline(times(), y) for y in readings.T]
    smooth = np.column_stack([one(times()) for one in splines])
    rate = splines[task.term.state].derivative()(times())
    first = task.first_model
    tree = sum(first.rates[task.term.state], sympy.S.Zero)
    call = sympy.lambdify([*first.states, *first.constants], tree, "numpy")

    def left(constants: FloatArray) -> FloatArray:
        with np.errstate(all="ignore"):
            return np.nan_to_num(rate - call(*smooth.T, *constants) * np.ones(len(rate)), posinf=1e6, neginf=-1e6)

    start = np.array([*first.constants.values()])
    return smooth, left(least_squares(left, start, loss="soft_l1").x if start.size else start)


def _sindy(smooth: FloatArray, residual: FloatArray, clean: FloatArray) -> FloatArray:
    """Compute SINDy's values over the true states, of products up to degree three, sines and cosines."""
    import pysindy

    library = pysindy.PolynomialLibrary(degree=3) + pysindy.FourierLibrary(n_frequencies=1)
    rows = np.asarray(library.fit_transform(smooth))
    scale = np.linalg.norm(rows, axis=0)
    optimizer = pysindy.STLSQ(threshold=0.2 * np.linalg.norm(residual))
    optimizer.fit(rows / scale, residual)
    weights = np.ravel(optimizer.coef_) / scale
    return np.asarray(library.transform(clean)) @ weights


def _gplearn(smooth: FloatArray, residual: FloatArray, clean: FloatArray) -> FloatArray:
    """Compute symbolic regression's values over the true states."""
    from gplearn.genetic import SymbolicRegressor

    functions = ("add", "sub", "mul", "div", "sqrt", "abs", "sin", "cos")
    search = SymbolicRegressor(
        population_size=1000, generations=15, function_set=functions, parsimony_coefficient="auto", random_state=1
    )
    search.fit(smooth, residual)
    return np.asarray(search.predict(clean))
