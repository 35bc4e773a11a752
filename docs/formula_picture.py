"""Picture of the page "What the library does not list": a conductance that grows with a flow."""

from __future__ import annotations

import io

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import least_squares

FloatArray = NDArray[np.float64]
READING, FIRST, FOUND = "#777777", "#0b62a4", "#b8500f"
CAPACITY, CONDUCTANCE, EXPONENT, SD, ROWS = 90.0, 3.5, 0.66, 0.08, 800


def temperature(power: FloatArray, conductance: FloatArray, capacity: float) -> FloatArray:
    """Compute the temperature (ROWS,) in K above the surroundings, once a second.

    Power in W and conductance in W/K are held.
    """
    found = np.zeros(ROWS)
    for k in range(ROWS - 1):
        end = power[k] / conductance[k]
        found[k + 1] = end + (found[k] - end) * np.exp(-conductance[k] / capacity)
    return found


def formula_picture() -> str:
    """Return the picture as SVG: readings with two fits, and the conductance of each over the flow."""
    rng = np.random.default_rng(1)
    power, flow = (np.repeat(rng.uniform(*ends, ROWS // hold + 1), hold)[:ROWS] for ends, hold in
                   (((20.0, 200.0), 40), ((0.5, 4.0), 60)))  # fmt: skip
    readings = temperature(power, CONDUCTANCE * flow**EXPONENT, CAPACITY) + SD * rng.standard_normal(ROWS)

    def fit(exponent_is_free: bool) -> FloatArray:
        def left(x: FloatArray) -> FloatArray:
            return readings - temperature(power, x[0] * flow ** (x[2] if exponent_is_free else 0.0), x[1])

        return np.asarray(least_squares(left, [5.0, 100.0, 0.3], x_scale=[1.0, 30.0, 0.3]).x)

    first, found = fit(False), fit(True)
    with matplotlib.rc_context({"font.size": 10, "svg.fonttype": "path", "svg.hashsalt": "aero-bayes"}):
        figure = Figure(figsize=(9.0, 2.9), layout="constrained")
        curve, law = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
        over, range_ = np.arange(ROWS), np.linspace(flow.min(), flow.max(), 100)
        curve.plot(over, readings, ".", color=READING, ms=2.0, label="readings")
        curve.plot(over, temperature(power, np.full(ROWS, first[0]), first[1]), color=FIRST, label="first model")
        curve.plot(over, temperature(power, found[0] * flow ** found[2], found[1]), color=FOUND, lw=1.0,
                   label="with the formula")  # fmt: skip
        law.plot(range_, np.full(100, first[0]), color=FIRST)
        law.plot(range_, found[0] * range_ ** found[2], color=FOUND)
        law.plot(range_[::12], CONDUCTANCE * range_[::12] ** EXPONENT, "o", mfc="none", color=READING)
        curve.set(xlabel="time (s)", ylabel="T (K)")
        law.set(xlabel="flow (m³/h)", ylabel="conductance (W/K)", ylim=(0.0, None))
        for axis in (curve, law):
            axis.spines[["top", "right"]].set_visible(False)
            axis.margins(x=0)
        curve.legend(loc="upper right", frameon=False, fontsize=9, ncols=3, bbox_to_anchor=(1.0, 1.2))
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None}, facecolor="white")
    return out.getvalue()
