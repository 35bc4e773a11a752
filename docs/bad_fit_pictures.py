"""Pictures of the page "Why is my fit bad?": simulated recordings, each with one of the five causes."""

from __future__ import annotations

import io
from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

FloatArray = NDArray[np.float64]
READING, FITTED, FAULT = "#777777", "#0b62a4", "#b8500f"
CAPACITY, CONDUCTANCE, SD, INTERVAL, ROWS = 2.0e6, 120.0, 0.05, 120.0, 600
TIME = INTERVAL * np.arange(ROWS)
HOURS = TIME / 3600.0


def room(capacity: float, loss: Callable[[float], float], start: float = 293.15) -> FloatArray:
    """Compute the temperature (ROWS,) in K of a room with a heater that is switched.

    ``loss`` is in W by K above the outside.
    """
    power = np.repeat(np.random.default_rng(1).choice([0.0, 1500.0, 3000.0], ROWS // 20), 20)
    outside = 278.0 + 5.0 * np.sin(2.0 * np.pi * TIME / 86400.0)
    temperature = np.empty(ROWS)
    temperature[0] = start
    for k in range(ROWS - 1):
        x = temperature[k]
        for _ in range(5):
            x += INTERVAL / 5.0 / capacity * (power[k] - loss(x - outside[k]))
        temperature[k + 1] = x
    return temperature


def linear_room(capacity: float, conductance: float) -> FloatArray:
    return room(capacity, lambda x: conductance * x)


def fitted_room(readings: FloatArray, largest: float = 1e4) -> FloatArray:
    """Return the room with a linear loss as least squares fits it, with a largest conductance in W/K."""

    def left(x: FloatArray) -> FloatArray:
        return readings - linear_room(1e6 * x[0], 100.0 * x[1])

    bounds = ([0.1, 0.1], [100.0, largest / 100.0])
    best = least_squares(left, [2.0, 0.9], bounds=bounds, x_scale=[0.1, 0.1]).x
    return linear_room(1e6 * best[0], 100.0 * best[1])


def noise() -> FloatArray:
    return SD * np.random.default_rng(2).standard_normal(ROWS)


def data(curve: Axes, rest: Axes) -> None:
    """Draw outliers and readings that stand for none."""
    fitted = linear_room(CAPACITY, CONDUCTANCE)
    readings = fitted + noise()
    rows = np.random.default_rng(5).choice(ROWS, 12, replace=False)
    readings[rows] += np.where(np.arange(12) % 2, 3.0, -3.0)
    draw(curve, rest, HOURS, readings, fitted, "T (K)", "time (h)")
    for axis, values in ((curve, readings), (rest, readings - fitted)):
        axis.plot(HOURS[rows], values[rows], "o", mfc="none", color=FAULT, ms=6)


def solver(curve: Axes, rest: Axes) -> None:
    """Draw a pendulum at a loose and at a tight tolerance."""
    time = np.linspace(0.0, 20.0, 1001)

    def slopes(_: float, x: FloatArray) -> list[float]:
        return [x[1], -49.0 * np.sin(x[0]) - 0.02 * x[1]]

    loose, tight = (solve_ivp(slopes, (0.0, 20.0), [1.5, 0.0], t_eval=time, rtol=r, atol=r).y[0] for r in (1e-4, 1e-10))
    readings = tight + 1e-3 * np.random.default_rng(2).standard_normal(time.size)
    draw(curve, rest, time, readings, loose, "angle (rad)", "time (s)")


def search(curve: Axes, rest: Axes) -> None:
    """Draw a fit of a conductance of 120 W/K, with an upper bound of 100."""
    readings = linear_room(CAPACITY, CONDUCTANCE) + noise()
    draw(curve, rest, HOURS, readings, fitted_room(readings, 100.0), "T (K)", "time (h)")


def noise_form(curve: Axes, rest: Axes) -> None:
    """Draw noise with heavy tails."""
    fitted = linear_room(CAPACITY, CONDUCTANCE)
    readings = fitted + 3.0 * SD * np.random.default_rng(5).standard_t(2.2, ROWS)
    draw(curve, rest, HOURS, readings, fitted, "T (K)", "time (h)")


def model(curve: Axes, rest: Axes) -> None:
    """Draw a loss that grows with the square, fitted by a linear one."""
    readings = room(CAPACITY, lambda x: 9.0 * x * abs(x)) + noise()
    draw(curve, rest, HOURS, readings, fitted_room(readings), "T (K)", "time (h)")


def draw(
    curve: Axes, rest: Axes, time: FloatArray, readings: FloatArray, fitted: FloatArray, axis: str, clock: str
) -> None:
    """Draw readings and fit on one axis, what is left on the other; the scale holds 99.9 % of it."""
    curve.plot(time, readings, ".", color=READING, ms=2.5, label="readings")
    curve.plot(time, fitted, color=FITTED, lw=1.0, label="fitted model")
    curve.set_ylabel(axis)
    rest.plot(time, readings - fitted, color=FITTED, lw=0.7)
    rest.set_ylabel(f"residual {axis[axis.index('(') :]}")
    rest.axhline(0.0, color=READING, lw=0.7)
    for one in (curve, rest):
        one.set_xlabel(clock)
        one.spines[["top", "right"]].set_visible(False)
        one.margins(x=0)
    curve.legend(loc="upper right", frameon=False, fontsize=9, ncols=2, bbox_to_anchor=(1.0, 1.2))


PICTURES = {"data": data, "solver": solver, "search": search, "noise": noise_form, "model": model}


def pictures() -> dict[str, str]:
    """Return the SVG of each cause."""
    found = {}
    with matplotlib.rc_context({"font.size": 10, "svg.fonttype": "path", "svg.hashsalt": "aero-bayes"}):
        for name, fill in PICTURES.items():
            figure = Figure(figsize=(9.0, 2.9), layout="constrained")
            fill(*figure.subplots(1, 2))
            out = io.StringIO()
            figure.savefig(out, format="svg", metadata={"Date": None}, facecolor="white")
            found[name] = out.getvalue()
    return found
