"""The AERO under the linear law, solved by hand: an independent second implementation for the tests."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
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


def quadratic_run(parameters, time, delay=0.0, volts=24.0, off=20.0):
    """The same under the quadratic law and with an input delay, by SciPy's LSODA at a tight tolerance."""
    p = BENCH | dict(parameters)
    inertia = p["J_r"] + p["J_s"]

    def rate(_, x, v):
        i, w, th, q = x
        return [
            (v - p["R_a"] * i - p["c_m"] * w) / p["L_a"],
            (p["c_m"] * i - p["k_d"] * w * abs(w)) / inertia,
            q,
            (2.0 * p["D_t"] * p["k_t"] * w * abs(w) - p["D_p"] * q - p["K_sp"] * th) / p["J_p"],
        ]

    edges = [0.0, delay, off + delay, time[-1]]
    state, out = np.zeros(4), np.zeros((time.size, 3))
    for begin, end, v in zip(edges, edges[1:], (0.0, volts, 0.0), strict=False):
        inside = (time >= begin - 1e-12) & (time < end - 1e-12) if end < time[-1] else time >= begin - 1e-12
        if end <= begin:
            continue
        found = solve_ivp(
            rate,
            (begin, end),
            state,
            "LSODA",
            args=(v,),
            rtol=1e-9,
            atol=[1e-10, 1e-7, 1e-11, 1e-11],
            t_eval=np.union1d(np.clip(time[inside], begin, end), [end]),
        )
        out[inside] = found.y[:3, : inside.sum()].T
        state = found.y[:, -1]
    return out
