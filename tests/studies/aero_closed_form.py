"""The AERO under the linear law, solved by hand: an independent second implementation for the tests."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

BENCH = {"c_m": 0.042, "J_p": 0.0219, "D_p": 0.0071, "K_sp": 0.0375, "D_t": 0.158}


def linear_run(parameters, time, volts=24.0, off=20.0):
    """Current, speed and pitch at even ``time`` at ``volts`` up to ``off`` s, then at zero: a matrix exponential."""
    p = BENCH | dict(parameters)
    inertia = p["J_r"] + p["J_s"]
    a = np.zeros((5, 5))
    a[0, [0, 1, 4]] = -p["R_a"] / p["L_a"], -p["c_m"] / p["L_a"], 1.0 / p["L_a"]
    a[1, :2] = p["c_m"] / inertia, -p["k_d"] / inertia
    a[2, 3] = 1.0
    a[3, 1:4] = 2.0 * p["D_t"] * p["k_t"] / p["J_p"], -p["K_sp"] / p["J_p"], -p["D_p"] / p["J_p"]
    step = expm(a * (time[1] - time[0]))
    state = np.array([0.0, 0.0, 0.0, 0.0, volts])
    rows = []
    for t in time:
        if t >= off - 1e-9:
            state[4] = 0.0
        rows.append(state[:3].copy())
        state = step @ state
    return np.array(rows)
