"""Recordings of a simulated drive that has play, made by a simulator that shares no code with the library."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Moment of inertia (kg m2), torque of the motor (N m/V), viscous friction (N m s/rad), and the spring (N m/rad), which
#: acts only outside the play (rad, half width).
INERTIA, GAIN, FRICTION, STIFFNESS, PLAY = 0.05, 1.2, 0.3, 28.0, 0.03
#: Standard deviation of the white noise (rad), interval between samples (s), rows, samples for which a voltage holds.
NOISE, INTERVAL, ROWS, HOLD = 5e-4, 0.01, 2000, 10
#: Steps of the simulator in one interval.
STEPS = 50


def angles(voltage: FloatArray) -> FloatArray:
    """Simulate the angle (n,) at the samples, from rest; the voltage (n,) holds from its sample to the next."""

    def acceleration(phi: float, w: float, u: float) -> float:
        stretch = phi - min(max(phi, -PLAY), PLAY)
        return (GAIN * u - FRICTION * w - STIFFNESS * stretch) / INERTIA

    h = INTERVAL / STEPS
    phi, w = 0.0, 0.0
    found = np.empty(voltage.size)
    for n, u in enumerate(voltage):
        found[n] = phi
        for _ in range(STEPS):  # Runge-Kutta-Nystroem of fourth order
            a = acceleration(phi, w, u)
            b = acceleration(phi + h / 2 * w + h * h / 8 * a, w + h / 2 * a, u)
            c = acceleration(phi + h / 2 * w + h * h / 8 * a, w + h / 2 * b, u)
            d = acceleration(phi + h * w + h * h / 2 * c, w + h * c, u)
            phi += h * w + h * h / 6 * (a + b + c)
            w += h / 6 * (a + 2 * b + 2 * c + d)
    return found


def write(folder: Path) -> None:
    """Write ``train.csv`` and ``test.csv``, with other voltages and noise in each."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(("train", "test")):
        rng = np.random.default_rng([36, seed])
        voltage = np.round(np.repeat(rng.uniform(-4.0, 4.0, ROWS // HOLD), HOLD), 4)
        angle = angles(voltage) + NOISE * rng.standard_normal(ROWS)
        table = np.column_stack([INTERVAL * np.arange(ROWS), voltage, angle])
        np.savetxt(folder / f"{name}.csv", table, "%.10g", delimiter=",", header="time,u,angle", comments="")
