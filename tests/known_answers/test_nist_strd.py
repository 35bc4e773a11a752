"""NIST's reference problems of nonlinear regression, all 27, from both starting points, through the local search.

Certified values have eleven digits and come from quadruple precision. Models are written from the formulas of the data
sets; derivatives are exact to rounding (complex step; Squire and Trapp, 1998, SIAM Rev. 40, 110).
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.estimate.levenberg_marquardt import FixedCost, LocalSettings, QuadraticModel, levenberg_marquardt

pytestmark = pytest.mark.fast

STRD = json.loads((Path(__file__).parent / "nist_strd.json").read_text())["problems"]


def decay(x, b):
    return b[0] * np.exp(-b[1] * x)


def bell(x, height, centre, width):
    return height * np.exp(-((x - centre) ** 2) / width**2)


def rational(x, top, bottom):
    return np.polyval(top[::-1], x) / (1 + x * np.polyval(bottom[::-1], x))


def harmonic(x, period, cosine, sine):
    return cosine * np.cos(2 * np.pi * x / period) + sine * np.sin(2 * np.pi * x / period)


def chwirut(x, b):
    return np.exp(-b[0] * x) / (b[1] + b[2] * x)


def lanczos(x, b):
    return decay(x, b[0:2]) + decay(x, b[2:4]) + decay(x, b[4:6])


def gauss(x, b):
    return decay(x, b) + bell(x, b[2], b[3], b[4]) + bell(x, b[5], b[6], b[7])


def saturating(x, b):
    return b[0] * (1 - np.exp(-b[1] * x))


MODELS: dict[str, Callable] = {
    "Misra1a": saturating,
    "BoxBOD": saturating,
    "Misra1b": lambda x, b: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda x, b: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda x, b: b[0] * b[1] * x / (1 + b[1] * x),
    "Chwirut1": chwirut,
    "Chwirut2": chwirut,
    "Lanczos1": lanczos,
    "Lanczos2": lanczos,
    "Lanczos3": lanczos,
    "Gauss1": gauss,
    "Gauss2": gauss,
    "Gauss3": gauss,
    "DanWood": lambda x, b: b[0] * x ** b[1],
    "Kirby2": lambda x, b: rational(x, b[:3], b[3:]),
    "Hahn1": lambda x, b: rational(x, b[:4], b[4:]),
    "Thurber": lambda x, b: rational(x, b[:4], b[4:]),
    "Nelson": lambda x, b: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]),
    "MGH09": lambda x, b: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda x, b: b[0] * np.exp(b[1] / (x + b[2])),
    "MGH17": lambda x, b: b[0] + decay(x, b[[1, 3]]) + decay(x, b[[2, 4]]),
    "Roszman1": lambda x, b: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "ENSO": lambda x, b: b[0] + harmonic(x, 12, b[1], b[2]) + harmonic(x, *b[3:6]) + harmonic(x, *b[6:9]),
    "Rat42": lambda x, b: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda x, b: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Eckerle4": lambda x, b: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Bennett5": lambda x, b: b[0] * (b[1] + x) ** (-1 / b[2]),
}


def residual(name, b):
    """Measured minus predicted, complex where ``b`` is."""
    x, y = np.array(STRD[name]["x"]), np.array(STRD[name]["y"])
    y = np.log(y) if name == "Nelson" else y
    return y - MODELS[name](x if x.shape[0] > 1 else x[0], b)


def cost_function(name, logarithmic):
    """The sum of squares as the search wants it: half of it, its gradient and Gauss-Newton Hessian."""

    def at(point):
        with np.errstate(all="ignore"):
            b = np.exp(point) if logarithmic else point
            r = residual(name, b)
            step = 1e-200
            columns = [residual(name, b + 1j * step * row).imag / step for row in np.eye(b.size)]
            jacobian = np.stack(columns, axis=1) * (b if logarithmic else 1.0)
        if not (np.all(np.isfinite(r)) and np.all(np.isfinite(jacobian))):
            return None
        return QuadraticModel(0.5 * r @ r, jacobian.T @ r, jacobian.T @ jacobian)

    return FixedCost(at)


def fit(name: str, start: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Values, scaled inverse Hessian's diagonal and sum of squares that the search ends at.

    Axes are the problems' own, but for MGH10: the resistance of a thermistor over temperature, whose three parameters
    are positive and start up to a factor 700 off. On its linear axes the search stays in a valley from start 1.
    """
    first = np.array(STRD[name]["starts"][start])
    logarithmic = name == "MGH10"
    settings = LocalSettings(
        iterations=1000, tolerance=0.0, relative_tolerance=1e-15, step_tolerance=1e-13, damping=1e4
    )
    origin = np.log(first) if logarithmic else first
    width = np.full(first.size, 50.0) if logarithmic else 1e6 * np.maximum(np.abs(first), 1e-3)
    found = levenberg_marquardt(cost_function(name, logarithmic), origin, origin - width, origin + width, settings)
    values = np.exp(found.point) if logarithmic else found.point
    hessian = found.quadratic.hessian
    scale = np.sqrt(np.diag(hessian))
    inverse = np.diag(np.linalg.inv(hessian / np.outer(scale, scale))) / scale**2
    return values, inverse * (values**2 if logarithmic else 1.0), 2.0 * found.cost


def digits(value, certified):
    """NIST's log relative error, at most 11."""
    error = np.abs(np.asarray(value) / np.asarray(certified) - 1.0)
    return float(np.min(np.minimum(-np.log10(np.maximum(error, 1e-300)), 11.0)))


@pytest.mark.parametrize("name", STRD)
def test_data_reproduce_the_certified_residual_sum_of_squares(name):
    assert len(STRD) == 27
    r = residual(name, np.array(STRD[name]["certified"]))
    if name == "Lanczos1":  # 1e-25 is certified: the eleven digits of its parameters leave 4e-21
        assert r @ r < 1e-20
    else:
        assert r @ r == pytest.approx(STRD[name]["residual_sum_of_squares"], rel=1e-9)


@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize("name", STRD)
def test_certified_values_and_standard_errors(name, start, trust):
    problem = STRD[name]
    values, inverse, squares = fit(name, start)
    trust("nist", digits(values, problem["certified"]))
    assert digits(values, problem["certified"]) >= 6
    freedom = len(problem["y"]) - values.size
    expected = 0.1 if name == "Lanczos1" else 1e-6  # its residual, 1e-13, is within rounding of nothing
    assert np.sqrt(inverse * squares / freedom) == pytest.approx(np.array(problem["standard_deviation"]), rel=expected)
