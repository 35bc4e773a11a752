"""A heated room with one time constant: its Modelica text, and recordings of it in closed form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import aero_bayes
from aero_bayes.data import Recording

FloatArray = NDArray[np.float64]
C, G, SD = 2.0e6, 120.0, 0.05
ROOM = """model Room
  parameter Real C(unit = "J/K", min = 1e4, max = 1e8) = 1e6 "Heat capacity";
  parameter Real G(unit = "W/K", min = 1.0, max = 1e4) = 60.0 "Conductance to the outside";
  input Real P(unit = "W");
  input Real T_amb(unit = "K");
  output Real T(unit = "K", start = 293.15);
equation
  C * der(T) = P - G * (T - T_amb);
end Room;
"""
UNITS = {"time": "s", "P": "W", "T_amb": "K", "T": "K"}


def recording(
    rows: int = 600, interval: float = 120.0, seed: int = 1, loss: Callable[[float], float] | None = None
) -> Recording:
    """A heater that is switched, an outside that swings over a day, and white noise of ``SD`` K.

    ``loss`` (W by K above the outside) replaces the linear loss; exact for a linear one, else in twenty small steps.
    """
    rng = np.random.default_rng(seed)
    time = interval * np.arange(rows)
    power = np.repeat(rng.choice([0.0, 1500.0, 3000.0], rows // 20 + 1), 20)[:rows]
    outside = np.round(278.0 + 5.0 * np.sin(2.0 * np.pi * time / 86400.0), 2)
    temperature = np.empty(rows)
    temperature[0] = 293.15
    decay = np.exp(-G / C * interval)
    for k in range(rows - 1):
        x = temperature[k]
        if loss is None:
            end = outside[k] + power[k] / G
            temperature[k + 1] = end + (x - end) * decay
        else:
            for _ in range(20):
                x += interval / 20.0 / C * (power[k] - loss(x - outside[k]))
            temperature[k + 1] = x
    readings = temperature + SD * rng.standard_normal(rows)
    return Recording("run", time, {"P": power, "T_amb": outside}, {"T": readings}, UNITS)


def with_readings(given: Recording, change: Callable[[FloatArray], FloatArray]) -> Recording:
    """The recording with other readings of T."""
    return Recording(given.name, given.time, given.inputs, {"T": change(given.outputs["T"].copy())}, UNITS)


def model(folder: Path) -> aero_bayes.Model:
    (folder / "Room.mo").write_text(ROOM)
    return aero_bayes.load_model(folder / "Room.mo")


def fit(given: Recording | list[Recording], room: aero_bayes.Model, workers: int = 0) -> aero_bayes.Fit:
    return aero_bayes.fit(given, room, parameters=["C", "G"], workers=workers)
