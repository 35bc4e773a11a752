"""The simulated AERO against two motors and a body integrated independently, and against closed forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulated_rigs.aero import HALF_QUAD, Truth, even_times, pivot_friction
from simulated_rigs.designs import Levels
from simulated_rigs.kinds import AERO
from simulated_rigs.truth import LawPlace, LawTruth, assembled

pytestmark = pytest.mark.long

P = AERO.parameters
REST = (0.0, 0.0, 0.0, 0.0)
TIME = even_times(8.0, 100.0)
VOLTS = Levels((0.0, 1.0, 2.5, 4.0, 5.2, 6.0), (14.0, -9.0, 18.0, 18.0, -17.0, 4.0)).volts(TIME)
SCALE = np.array([1, 1e3, 1, 1e3, 1, 1, 1, 1, 1e3])
#: time, states, voltage -> rates
Rates = Callable[[float, np.ndarray, float], list[float]]


def law(name: str, kind: str, place: str, **parameters: float) -> LawTruth:
    return LawTruth(name, LawPlace(kind, place), parameters)


def two_motors(p: Mapping[str, float], motors: int, **x: float) -> Rates:
    """Both motors written out; states i1, w1, i2, w2, theta, q, r1, r2 (rise of resistance) and the shown speed."""
    g = {"r_h": 0.0, "T_h": 1.0, "u_max": np.inf, "d_r": 0.0, "c_b": 0.0, "k_3": 0.0, "T_w": 1.0} | x

    def motor(v: float, i: float, w: float, r: float) -> tuple[float, float]:
        drop = (p["R_a"] + r) * i + p["c_m"] * w
        brake = p["k_d"] * w * abs(w) + g["d_r"] * w
        return (np.clip(v, -g["u_max"], g["u_max"]) - drop) / p["L_a"], (p["c_m"] * i - brake) / (p["J_r"] + p["J_s"])

    def rates(t: float, s: np.ndarray, v: float) -> list[float]:
        i1, w1, i2, w2, th, q, r1, r2, shown = s
        torque = sum(arm * p["k_t"] * w * abs(w) for w, arm in ((w1, p["D_t"]), (w2, -p["D_t"]))[:motors])
        torque -= g["k_3"] * th**3 + g["c_b"] * q * abs(q) + p["D_p"] * q + p["K_sp"] * th
        heat = [(g["r_h"] * i * i - r) / g["T_h"] for i, r in ((i1, r1), (i2, r2))]
        return [*motor(v, i1, w1, r1), *motor(-v, i2, w2, r2), q, torque / p["J_p"], *heat, (w1 - shown) / g["T_w"]]

    return rates


def reference(
    rates: Rates, volts: np.ndarray, size: int = 9, time: np.ndarray = TIME, rtol: float = 1e-10
) -> np.ndarray:
    """States from rest, shape (n, size), integrated from jump to jump."""
    out = [np.zeros(size)]
    for first, last in pairwise([0, *(np.flatnonzero(np.diff(volts)) + 1).tolist(), time.size - 1]):
        span, atol = time[first : last + 1], 0.1 * rtol * (SCALE if size == SCALE.size else 1.0)
        run = solve_ivp(rates, (span[0], span[-1]), out[-1], "LSODA", span, args=(volts[first],), rtol=rtol, atol=atol)
        out += list(run.y.T[1:])
    return np.array(out)


def errors(truth: Truth, states: np.ndarray) -> float:
    """Largest error of current, speed and pitch as a share of each one's range."""
    outputs, _ = truth.run(TIME, VOLTS)
    return float((np.abs(outputs - states).max(axis=0) / np.ptp(states, axis=0)).max())


def test_both_set_ups_by_themselves_and_with_laws() -> None:
    assert errors(Truth(), reference(two_motors(P, 2), VOLTS)[:, [0, 1, 4]]) < 1.5e-7
    assert errors(Truth(parameters=HALF_QUAD), reference(two_motors(HALF_QUAD, 1), VOLTS)[:, [0, 1, 4]]) < 1.5e-7
    laws = (
        law("heating", "balance", "i", r_h=40.0, T_h=6.0), law("saturation", "input", "V_m", u_max=12.0),
        law("viscous_friction", "balance", "w", d=8e-6), law("quadratic_drag", "balance", "q", c=0.02),
        law("cubic_stiffness", "balance", "q", k_3=0.08), law("lag", "output", "omega_m", T=0.05),
    )  # fmt: skip
    rates = two_motors(P, 2, r_h=40.0, T_h=6.0, u_max=12.0, d_r=8e-6, c_b=0.02, k_3=0.08, T_w=0.05)
    assert errors(Truth(laws), reference(rates, VOLTS)[:, [0, 8, 4]]) < 2e-7


def test_delays_shift_what_they_delay() -> None:
    base, _ = Truth().run(TIME, VOLTS)
    late, _ = Truth((law("delay", "output", "pitch", T=0.07),)).run(TIME, VOLTS)
    np.testing.assert_allclose(late[7:, 2], base[:-7, 2], atol=1e-8)
    assert (late[:7, 2] == base[0, 2]).all()
    np.testing.assert_allclose(late[:, 1], base[:, 1], atol=1e-5)
    slow, _ = Truth(input_delay=0.03).run(TIME, VOLTS)
    assert (np.abs(slow[3:] - base[:-3]).max(axis=0) < 1e-7 * np.ptp(base, axis=0)).all()
    assert (slow[:3] == 0.0).all()


def test_a_force_is_held_from_sample_to_sample() -> None:
    """Two steps of torque on the body: each answered by a damped swing about its rest."""
    rig = assembled(AERO, P, [])
    rig.push("q", np.where(TIME < 4.0, 2e-3, -1e-3))
    theta = rig.run(TIME, np.zeros((TIME.size, 1)), REST)[0][:, 2]
    decay, rest = P["D_p"] / (2.0 * P["J_p"]), 2e-3 / P["K_sp"]
    w = np.sqrt(P["K_sp"] / P["J_p"] - decay**2)

    def answer(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0.0)
        return 1.0 - np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t))

    np.testing.assert_allclose(theta, rest * (answer(TIME) - 1.5 * answer(TIME - 4.0)), atol=2e-9)


def test_stuck_body_does_not_move_until_it_is_pushed_hard_enough() -> None:
    time = even_times(20.0, 100.0)
    ramp = Levels(tuple(np.arange(0.0, 20.0, 0.5)), tuple(np.arange(40) * 0.4))
    outputs, _ = Truth((pivot_friction(2e-3),)).run(time, ramp.volts(time))
    first = int(np.argmax(2.0 * P["D_t"] * P["k_t"] * outputs[:, 1] ** 2 > 2e-3))
    assert (outputs[:first, 2] == 0.0).all()
    assert outputs[first + 20, 2] > 1e-5


def test_rotor_sticks_below_its_friction_and_settles_above_it() -> None:
    tau, time = 1.5e-3, even_times(20.0, 100.0)
    truth = Truth((law("coulomb_friction", "balance", "w", F_c=tau),))
    hold = 0.95 * tau * P["R_a"] / P["c_m"]
    outputs, _ = truth.run(time, np.full(time.size, hold))
    assert (outputs[:, 1] == 0.0).all()
    assert outputs[-1, 0] == pytest.approx(hold / P["R_a"], rel=1e-9)
    outputs, _ = truth.run(time, np.where(time < 10.0, 12.0, 0.0))
    assert outputs[990, 0] * P["c_m"] == pytest.approx(P["k_d"] * outputs[990, 1] ** 2 + tau, rel=1e-6)
    assert (outputs[time > 12.0, 1] == 0.0).all()


def test_brush_drop_blocks_small_voltages_and_takes_its_share_of_others() -> None:
    truth, time = Truth((law("contact_drop", "balance", "i", V_c=0.8),)), even_times(10.0, 100.0)
    assert (truth.run(time, np.full(time.size, 0.79))[0][:, 0] == 0.0).all()
    i, w, _ = truth.run(time, np.full(time.size, -12.0))[0][-1]
    assert P["R_a"] * i + P["c_m"] * w - 0.8 == pytest.approx(-12.0, rel=1e-6)
    # Released, the motor turns on with no current at all once its voltage is below the drop.
    outputs, _ = truth.run(time, np.where(time < 5.0, 3.0, 0.0))
    coasting = (time > 5.0) & (P["c_m"] * outputs[:, 1] < 0.79)
    assert coasting.sum() > 10
    assert (outputs[coasting, 0] == 0.0).all()
