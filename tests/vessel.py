"""A vessel that is fed and leaks: ``der(level) = gain * u - k * level``, exact for an input that is held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SD = 0.01


def levels(u: FloatArray, gain: float = 1.0, k: float = 0.5, step: float = 0.1) -> FloatArray:
    """The level at each sample, from an empty vessel."""
    found = np.zeros(u.size)
    for n in range(u.size - 1):
        rest = gain * u[n] / k
        found[n + 1] = rest + (found[n] - rest) * np.exp(-k * step)
    return found


def record(
    path: Path,
    header: str = "time,u,level",
    gain: float = 1.0,
    k: float = 0.5,
    step: float = 0.1,
    sd: float = SD,
    zero: float = 0.0,
) -> Path:
    """A file of 400 rows with an input of 20 levels, white noise, and a reading of ``zero`` at level 0."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(0.0, 2.0, 20), 20)
    readings = zero + levels(u, gain, k, step) + sd * rng.normal(size=400)
    rows = np.column_stack([step * np.arange(400), u, readings])
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return path
