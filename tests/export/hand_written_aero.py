"""The benches written down by hand, independently of the Modelica package."""

from __future__ import annotations

from collections.abc import Mapping

NOMINAL = {
    "R_a": 8.4, "L_a": 1.16e-3, "c_m": 0.042, "J_r": 4e-6, "J_s": 4e-6, "k_d": 2.4e-8, "k_t": 2.9e-7,
    "J_p": 0.0219, "D_p": 0.0071, "K_sp": 0.0375, "D_t": 0.158,
}  # fmt: skip
#: States and their sizes; a bench with one motor lacks the last two.
SCALES = {
    "i_m": 1.0, "omega_m": 300.0, "theta": 0.5, "body.omega": 1.0,
    "thruster_2.motor.inductor.i": 1.0, "thruster_2.motor.rotor.w": 300.0,
}  # fmt: skip
TWO_DOF_NOMINAL = NOMINAL | {
    "J_r": 1e-5, "k_d": 1e-7, "k_t": 1.2e-6, "k_dt": 1e-7, "k_tt": 1.2e-6, "J_y": 0.022, "D_y": 0.022,
}  # fmt: skip
TWO_DOF_SCALES = {
    "thruster_m.motor.inductor.i": 1.0, "omega_m": 300.0, "thruster_t.motor.inductor.i": 1.0, "omega_t": 300.0,
    "theta": 0.5, "body.omega": 1.0, "psi": 3.0, "body.rate": 1.0,
}  # fmt: skip


def motor(i: float, w: float, v: float, p: Mapping[str, float], *, linear: bool = False) -> tuple[float, float, float]:
    """Rates of current and speed (the paper's Eqs. 1 to 3 and 5), and the thrust (Eq. 4)."""
    size = w if linear else w * abs(w)
    di = (v - p["R_a"] * i - p["c_m"] * w) / p["L_a"]
    dw = (p["c_m"] * i - p["k_d"] * size) / (p["J_r"] + p["J_s"])
    return di, dw, p["k_t"] * size


def one_dof(x: Mapping[str, float], v: float, p: Mapping[str, float], *, linear: bool = False) -> dict[str, float]:
    """Rates by the names of the states; with one motor where there are no states of a second one."""
    rates = {"theta": x["body.omega"]}
    rates["i_m"], rates["omega_m"], force = motor(x["i_m"], x["omega_m"], v, p, linear=linear)
    i, w = (name for name in SCALES if name.startswith("thruster_2"))
    if i in x:
        rates[i], rates[w], other = motor(x[i], x[w], -v, p, linear=linear)
        force -= other
    rates["body.omega"] = (p["D_t"] * force - p["D_p"] * x["body.omega"] - p["K_sp"] * x["theta"]) / p["J_p"]
    return rates
