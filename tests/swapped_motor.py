"""A geared motor with dry friction that its model lacks: recorded on steps and on a chirp, by an integrator of our own.

On the steps the voltage is held between samples; on the chirp it runs in straight lines from sample to sample.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

MODEL = """model GearDrive "A motor that drives a load"
  parameter Real R(unit = "Ohm", min = 0) = 1.2 "Resistance of the winding";
  parameter Real L(unit = "H", min = 0) = 0.002 "Inductance of the winding (data sheet)";
  parameter Real c(unit = "N.m/A", min = 0) = 0.06 "Torque constant";
  parameter Real J(unit = "kg.m2", min = 0) = 0.0006 "Inertia (weighed)";
  parameter Real d(unit = "N.m.s", min = 0) = 0.0005 "Damping of the bearings";
  input Real u(unit = "V") "Voltage";
  output Real i(unit = "A") "Current, as measured";
  output Real w(unit = "rad/s") "Speed, as measured";
  Real current(unit = "A", start = 0, fixed = true) "Current";
  Real speed(unit = "rad/s", start = 0, fixed = true) "Speed of the load";
equation
  L * der(current) = u - R * current - c * speed;
  J * der(speed) = c * current - d * speed;
  i = current;
  w = speed;
end GearDrive;
"""
CONFIG = """[model]
sources = ["GearDrive.mo"]
name = "GearDrive"
[data]
inputs = ["u"]
outputs = ["i", "w"]
[parameters]
R = {free = true}
c = {free = true}
d = {free = true}
[loop]
laws = ["coulomb_friction", "square_law", "gain"]
"""
R, L, C, J, D = 1.0, 0.002, 0.05, 0.0006, 0.0004
#: Dry friction (N m), and noise of current (A) and speed (rad/s).
FRICTION, NOISE = 0.012, (0.012, 0.15)
RATE, DURATION = 100.0, 20.0


def voltage(kind: str, rng: np.random.Generator, time: NDArray[np.float64]) -> Callable[[float], float]:
    """Return the voltage over time: levels that change every 0.62 s, or a chirp from 0.1 to 6 Hz."""
    if kind == "chirp":
        samples = 5.0 * np.sin(2.0 * np.pi * (0.1 + 5.9 * time / (2.0 * DURATION)) * time)
        return lambda t: float(np.interp(t, time, samples))
    levels = rng.uniform(-6.0, 6.0, 64).round(1)
    return lambda t: float(levels[min(int(t / 0.62 + 1e-9), 63)])


def simulate(kind: str, seed: int) -> NDArray[np.float64]:
    """Return a recording, shape (n, 4): time, u, i and w."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, DURATION + 0.5 / RATE, 1.0 / RATE)
    u = voltage(kind, rng, time)

    def slopes(t: float, x: NDArray[np.float64]) -> list[float]:
        i, w = x
        return [(u(t) - R * i - C * w) / L, (C * i - D * w - FRICTION * np.tanh(w / 0.05)) / J]

    solved = solve_ivp(slopes, (0.0, time[-1]), [0.0, 0.0], "LSODA", time, rtol=1e-7, atol=1e-8, max_step=0.005)
    readings = solved.y.T + rng.normal(size=(len(time), 2)) * NOISE
    return np.column_stack([time, [u(t) for t in time], readings])


def write(folder: Path) -> None:
    """Write the model, its configuration, steps.csv and chirp.csv."""
    (folder / "GearDrive.mo").write_text(MODEL, "utf-8")
    (folder / "rig.toml").write_text(CONFIG, "utf-8")
    for seed, kind in enumerate(("steps", "chirp")):
        np.savetxt(folder / f"{kind}.csv", simulate(kind, seed), "%.7g", ",", header="time,u,i,w", comments="")
