"""The benches written down by hand, independently of the Modelica package."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NOMINAL = {
    "R_a": 8.4, "L_a": 1.16e-3, "c_m": 0.042, "J_r": 4e-6, "J_s": 4e-6, "k_d": 2.4e-8, "k_t": 2.9e-7,
    "J_p": 0.0219, "D_p": 0.0071, "K_sp": 0.0375, "D_t": 0.158,
}  # fmt: skip


def motor(i: float, w: float, v: float, p: Mapping[str, float], *, linear: bool) -> tuple[float, float, float]:
    """Rates of current and speed (the paper's Eqs. 1 to 3 and 5), and the thrust (Eq. 4)."""
    size = w if linear else w * abs(w)
    di = (v - p["R_a"] * i - p["c_m"] * w) / p["L_a"]
    dw = (p["c_m"] * i - p["k_d"] * size) / (p["J_r"] + p["J_s"])
    return di, dw, p["k_t"] * size


def one_dof(x: FloatArray, v: float, p: Mapping[str, float], *, linear: bool = False) -> dict[str, float]:
    """Rates with both motors; x = i1, w1, theta, rate, i2, w2."""
    i1, w1, theta, rate, i2, w2 = x
    di1, dw1, f1 = motor(i1, w1, v, p, linear=linear)
    di2, dw2, f2 = motor(i2, w2, -v, p, linear=linear)
    acceleration = (p["D_t"] * (f1 - f2) - p["D_p"] * rate - p["K_sp"] * theta) / p["J_p"]
    return {
        "i_m": di1, "omega_m": dw1, "theta": rate, "body.omega": acceleration,
        "thruster_2.motor.inductor.i": di2, "thruster_2.motor.rotor.w": dw2,
    }  # fmt: skip


def half_quad(x: FloatArray, v: float, p: Mapping[str, float], *, linear: bool = False) -> dict[str, float]:
    """Rates with one motor; x = i, w, theta, rate."""
    i, w, theta, rate = x
    di, dw, f = motor(i, w, v, p, linear=linear)
    acceleration = (p["D_t"] * f - p["D_p"] * rate - p["K_sp"] * theta) / p["J_p"]
    return {"i_m": di, "omega_m": dw, "theta": rate, "body.omega": acceleration}


STATES = ("i_m", "omega_m", "theta", "body.omega", "thruster_2.motor.inductor.i", "thruster_2.motor.rotor.w")
SCALES = np.array([1.0, 300.0, 0.5, 1.0, 1.0, 300.0])

TWO_DOF_NOMINAL = NOMINAL | {
    "J_r": 1e-5,
    "k_d": 1e-7,
    "k_t": 1.2e-6,
    "k_dt": 1e-7,
    "k_tt": 1.2e-6,
    "J_y": 0.022,
    "D_y": 0.022,
}
TWO_DOF_SCALES = {
    "thruster_m.motor.inductor.i": 1.0, "omega_m": 300.0, "thruster_t.motor.inductor.i": 1.0, "omega_t": 300.0,
    "theta": 0.5, "body.omega": 1.0, "psi": 3.0, "body.rate": 1.0,
}  # fmt: skip


def two_dof(x: Mapping[str, float], v_m: float, v_t: float, p: Mapping[str, float]) -> dict[str, float]:
    """Rates of the bench that is free in pitch and yaw, by the name of the state."""
    w_m, w_t, theta = x["omega_m"], x["omega_t"], x["theta"]
    pitch, yaw = x["body.omega"], x["body.rate"]
    di_m, dw_m, f_m = motor(x["thruster_m.motor.inductor.i"], w_m, v_m, p, linear=False)
    tail = {**p, "k_d": p["k_dt"], "k_t": p["k_tt"]}
    di_t, dw_t, f_t = motor(x["thruster_t.motor.inductor.i"], w_t, v_t, tail, linear=False)
    inertia = p["J_r"] + p["J_s"]
    back_m, back_t = inertia * dw_m + p["k_d"] * w_m * abs(w_m), inertia * dw_t + p["k_dt"] * w_t * abs(w_t)
    sine, cosine = np.sin(theta), np.cos(theta)
    swing, spin = p["J_p"] * sine * cosine, inertia * w_m * sine
    about_pitch = p["D_t"] * f_m + back_t - p["D_p"] * pitch - p["K_sp"] * sine - swing * yaw**2 - spin * yaw
    about_yaw = cosine * (p["D_t"] * f_t - back_m) - p["D_y"] * yaw + 2.0 * swing * pitch * yaw + spin * pitch
    return {
        "thruster_m.motor.inductor.i": di_m, "omega_m": dw_m, "thruster_t.motor.inductor.i": di_t, "omega_t": dw_t,
        "theta": pitch, "body.omega": about_pitch / p["J_p"],
        "psi": yaw, "body.rate": about_yaw / (p["J_y"] - p["J_p"] * sine**2),
    }  # fmt: skip
