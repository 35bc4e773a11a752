"""Rigs without laws whose equations are linear: exact under held inputs, one filter a mode."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from simulated_rigs.plant import Plant

FloatArray = NDArray[np.float64]


def run_linear(
    plant: Plant, step: float, commands: FloatArray, start: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    """Simulate outputs, shape (n, outputs), and states, shape (n, states), at samples ``step`` s apart.

    The equations dx/dt = A x + B u + c are read off by unit vectors. Over a sample x becomes Phi x + Gamma (u, 1); in
    the basis of Phi's eigenvectors each state is a first-order filter of its own.
    """
    states, inputs = len(start), commands.shape[1]
    capacity = np.array(plant.capacity)
    origin = np.array(plant.efforts([0.0] * states, [0.0] * inputs)) / capacity

    def column(k: int) -> FloatArray:
        unit = [0.0] * (states + inputs)
        unit[k] = 1.0
        value: FloatArray = np.array(plant.efforts(unit[:states], unit[states:])) / capacity - origin
        return value

    system = np.zeros((states + inputs + 1,) * 2)
    system[:states] = np.column_stack([*(column(k) for k in range(states + inputs)), origin])
    transition = expm(system * step)[:states]
    modes, basis = np.linalg.eig(transition[:, :states])
    driven = np.linalg.solve(basis, transition[:, states:] @ np.column_stack([commands, np.ones(len(commands))]).T)
    first = np.linalg.solve(basis, np.array(start, dtype=complex))
    found = np.empty((states, len(commands)), dtype=complex)
    for k, mode in enumerate(modes):
        found[k, 0] = first[k]
        found[k, 1:] = lfilter([1.0], [1.0, -mode], driven[k, :-1], zi=[mode * first[k]])[0]
    x = (basis @ found).real.T
    return x[:, list(plant.shown)], x
