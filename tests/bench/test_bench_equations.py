"""The bench against two motors and a body integrated independently, and against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from simulated_rigs import simulate_rig
from simulated_rigs.aero import KINDS, Truth, effect, even_times, simulate_truth
from simulated_rigs.designs import Levels, paper_step
from simulated_rigs.kinds.aero import AERO, HALF_QUAD, Parameters

pytestmark = pytest.mark.long

P = Parameters()
DESIGN = Levels((0.0, 1.0, 2.5, 4.0, 5.2, 6.0), (14.0, -9.0, 18.0, 18.0, -17.0, 4.0))
TIME = even_times(8.0, 100.0)

#: Sizes that are plain to see.
SIZES = {
    "supply_resistance": 3.0, "brush_drop": 0.6, "winding_heating": 60.0, "amplifier_deadzone": 0.8,
    "amplifier_saturation": 1.0 / 13.0, "rotor_coulomb_friction": 1e-3, "rotor_viscous_friction": 6e-6,
    "thrust_inflow_loss": 3e-4, "thrust_lag": 0.1, "thrust_asymmetry": -0.1, "pivot_coulomb_friction": 1.5e-3,
    "pivot_presliding_friction": 5e-3, "body_quadratic_drag": 2e-2, "gravity_offset": 2e-3, "cubic_stiffness": 3e-2,
    "current_offset": 5e-2, "speed_lag": 0.05, "pitch_delay": 0.05, "pitch_offset": 0.03,
}  # fmt: skip

#: state (i1, w1, i2, w2, theta, q, r1, r2, f1, f2, w_shown): r winding rise, f lagged thrust.
Rates = Callable[[float, np.ndarray, float], list[float]]


def two_motors(p: Parameters, motors: int, **x: float) -> Rates:
    """Both motors written out, every smooth effect by its formula; parameters absent are zero."""
    g = dict.fromkeys(("R_s", "r_h", "V_dz", "s_sat", "d_r", "k_v", "T_f", "a_f", "c_b", "tau_g", "k_3", "T_w"), 0.0)
    g |= {"T_h": 1.0} | x

    def motor(v: float, i: float, w: float, r: float) -> tuple[float, float]:
        if abs(v) <= g["V_dz"]:
            v = 0.0
        elif g["V_dz"]:
            v -= g["V_dz"] * np.sign(v)
        if g["s_sat"]:
            v = np.clip(v, -1.0 / g["s_sat"], 1.0 / g["s_sat"])
        drop = (p.R_a + g["R_s"] + r) * i + p.c_m * w
        return (v - drop) / p.L_a, (p.c_m * i - p.k_d * w * abs(w) - g["d_r"] * w) / (p.J_r + p.J_s)

    def rates(t: float, s: np.ndarray, v: float) -> list[float]:
        i1, w1, i2, w2, th, q, r1, r2, f1, f2, shown = s
        di1, dw1 = motor(v, i1, w1, r1)
        di2, dw2 = motor(-v, i2, w2, r2)
        torque, lagged = 0.0, []
        for w, arm, f in ((w1, p.D_t, f1), (w2, -p.D_t, f2))[:motors]:
            static = p.k_t * w * abs(w)
            static *= 1.0 + g["a_f"] * np.sign(arm * static)
            static -= g["k_v"] * abs(w) * arm * q
            lagged.append((static - f) / g["T_f"] if g["T_f"] else 0.0)
            torque += arm * (f if g["T_f"] else static)
        torque += g["tau_g"] * np.cos(th) - g["k_3"] * th**3 - g["c_b"] * q * abs(q) - p.D_p * q - p.K_sp * th
        heat = [(g["r_h"] * i * i - r) / g["T_h"] for i, r in ((i1, r1), (i2, r2))]
        lagged += [0.0] * (2 - len(lagged))
        return [di1, dw1, di2, dw2, q, torque / p.J_p, *heat, *lagged, (w1 - shown) / g["T_w"] if g["T_w"] else 0.0]

    return rates


def reference(rates: Rates, volts: np.ndarray, theta: float = 0.0) -> np.ndarray:
    """States at TIME, shape (n, 11), integrated from jump to jump."""
    state = np.zeros(11)
    state[4] = theta
    out = [state]
    edges = [0, *(np.flatnonzero(np.diff(volts)) + 1).tolist(), TIME.size - 1]
    for first, last in pairwise(edges):
        span = TIME[first : last + 1]
        scale = np.array([1, 1e3, 1, 1e3, 1, 1, 1, 1, 1, 1, 1e3])
        run = solve_ivp(
            rates, (span[0], span[-1]), state, "LSODA", span, args=(volts[first],), rtol=1e-10, atol=1e-11 * scale
        )
        out += list(run.y.T[1:])
        state = run.y[:, -1]
    return np.array(out)


def errors(truth: Truth, states: np.ndarray, speed: int = 1) -> np.ndarray:
    """Largest error of current, speed and pitch as a share of each one's range."""
    run = simulate_truth(truth, DESIGN, TIME)
    pairs = ((run.i_m, states[:, 0]), (run.omega_m, states[:, speed]), (run.theta, states[:, 4]))
    return np.array([np.abs(ours - theirs).max() / np.ptp(theirs) for ours, theirs in pairs])


def test_both_set_ups_without_effects() -> None:
    volts = DESIGN.volts(TIME)
    assert errors(Truth(), reference(two_motors(P, 2), volts)).max() < 1.5e-7
    assert errors(Truth("half_quad", HALF_QUAD), reference(two_motors(HALF_QUAD, 1), volts)).max() < 1.5e-7


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("supply_resistance", {"R_s": 2.0}),
        ("winding_heating", {"r_h": 40.0, "T_h": 6.0}),
        ("amplifier_deadzone", {"V_dz": 1.5}),
        ("amplifier_saturation", {"s_sat": 1.0 / 12.0}),
        ("rotor_viscous_friction", {"d_r": 8e-6}),
        ("thrust_inflow_loss", {"k_v": 5e-4}),
        ("thrust_lag", {"T_f": 0.1}),
        ("thrust_asymmetry", {"a_f": 0.2}),
        ("body_quadratic_drag", {"c_b": 0.02}),
        ("gravity_offset", {"tau_g": -4e-3}),
        ("cubic_stiffness", {"k_3": 0.08}),
        ("speed_lag", {"T_w": 0.05}),
    ],
)
def test_smooth_effects(name: str, parameters: dict[str, float]) -> None:
    truth = Truth(effects=(effect(name, **parameters),))
    states = reference(two_motors(P, 2, **parameters), DESIGN.volts(TIME), resting(parameters.get("tau_g", 0.0)))
    assert errors(truth, states, 10 if name == "speed_lag" else 1).max() < 2e-7


def resting(offset: float) -> float:
    """The pitch at which the spring holds a mass off the pivot."""
    return float(brentq(lambda theta: offset * np.cos(theta) - P.K_sp * theta, -0.5, 0.5, xtol=1e-15))


def test_sensor_offsets() -> None:
    base = simulate_truth(Truth(), DESIGN, TIME)
    shifted = simulate_truth(
        Truth(effects=(effect("current_offset", b_i=0.03), effect("pitch_offset", b_th=-0.02))), DESIGN, TIME
    )
    np.testing.assert_allclose(shifted.i_m - base.i_m, 0.03, rtol=1e-9)
    np.testing.assert_allclose(shifted.theta - base.theta, -0.02, rtol=1e-9)


def test_delays_shift_what_they_delay() -> None:
    base = simulate_truth(Truth(), DESIGN, TIME)
    late = simulate_truth(Truth(effects=(effect("pitch_delay", T_d=0.07),)), DESIGN, TIME)
    np.testing.assert_allclose(late.theta[7:], base.theta[:-7], atol=1e-8)
    assert (late.theta[:7] == base.theta[0]).all()
    np.testing.assert_allclose(late.omega_m, base.omega_m, atol=1e-5)
    slow = simulate_truth(Truth(input_delay=0.03), DESIGN, TIME)
    for name in ("i_m", "omega_m", "theta"):
        ours, theirs = getattr(slow, name), getattr(base, name)
        np.testing.assert_allclose(ours[3:], theirs[:-3], atol=1e-7 * np.ptp(theirs))
        assert (ours[:3] == 0.0).all()


@pytest.mark.parametrize("name", KINDS)
def test_effects_vanish_with_their_magnitude_and_show_without(name: str) -> None:
    base = simulate_truth(Truth(), DESIGN, TIME)
    for size in (0.0, SIZES[name]):
        values = dict.fromkeys(KINDS[name].parameters, 5.0 if name == "winding_heating" else 0.02)
        values[KINDS[name].parameters[0]] = size
        run = simulate_truth(Truth(effects=(effect(name, **values),)), DESIGN, TIME)
        changes = [
            np.abs(getattr(run, output) - getattr(base, output)).max() / np.ptp(getattr(base, output))
            for output in ("i_m", "omega_m", "theta")
        ]
        assert max(changes) < 5e-7 if size == 0.0 else max(changes) > 3e-3


@pytest.mark.parametrize(("system", "p", "motors"), [("one_dof", P, 2), ("half_quad", HALF_QUAD, 1)])
def test_steady_state(system: str, p: Parameters, motors: int) -> None:
    run = simulate_truth(Truth(system, p), Levels((0.0,), (15.0,)), even_times(60.0, 20.0))
    # R i + c w = V with c i = k_d w^2 is a quadratic in w.
    a, b = p.R_a * p.k_d / p.c_m, p.c_m
    w = (-b + np.sqrt(b * b + 4.0 * a * 15.0)) / (2.0 * a)
    assert run.omega_m[-1] == pytest.approx(w, rel=1e-9)
    assert run.i_m[-1] == pytest.approx(p.k_d * w * w / p.c_m, rel=1e-8)
    assert run.theta[-1] == pytest.approx(motors * p.D_t * p.k_t * w * w / p.K_sp, rel=1e-3)


def test_documented_thrust_gain() -> None:
    run = simulate_truth(Truth(), paper_step(), even_times(20.0, 20.0))
    torque = 2.0 * P.D_t * P.k_t * run.omega_m[-1] ** 2
    assert torque == pytest.approx(0.0011 * 24.0, rel=0.02)


def test_free_swing_is_a_cosine_and_dies_away_as_its_damping_says() -> None:
    p = Parameters()
    run = simulate_truth(Truth("one_dof", p), Levels((), ()), TIME, 0.5)
    decay = p.D_p / (2.0 * p.J_p)
    w = np.sqrt(p.K_sp / p.J_p - decay**2)
    swing = np.cos(w * TIME) + decay / w * np.sin(w * TIME)
    np.testing.assert_allclose(run.theta, 0.5 * np.exp(-decay * TIME) * swing, atol=2e-9)


def test_error_falls_with_the_tolerance() -> None:
    volts, settings = DESIGN.volts(TIME)[:, None], AERO.parameters
    start, states = (0.0,) * 4, reference(two_motors(P, 2), DESIGN.volts(TIME))
    found = []
    for relative in (1e-5, 1e-7, 1e-9):
        outputs, _ = simulate_rig(AERO, settings, [], TIME, volts, start, relative)
        found.append(np.abs(outputs[:, 2] - states[:, 4]).max())
    assert found[2] < found[1] < found[0]
    assert found[2] < 1e-7 * np.ptp(states[:, 4])


def test_torque_on_the_body_is_held_from_sample_to_sample() -> None:
    torque = np.where(TIME < 4.0, 2e-3, -1e-3)
    run = simulate_truth(Truth(), Levels((), ()), TIME, torque=torque)
    decay, rest = P.D_p / (2.0 * P.J_p), 2e-3 / P.K_sp
    w = np.sqrt(P.K_sp / P.J_p - decay**2)
    first = TIME <= 4.0
    swing = np.exp(-decay * TIME) * (np.cos(w * TIME) + decay / w * np.sin(w * TIME))
    np.testing.assert_allclose(run.theta[first], rest * (1.0 - swing[first]), atol=2e-9)
    after = TIME[~first] - 4.0
    response = np.exp(-decay * after) * (np.cos(w * after) + decay / w * np.sin(w * after))
    np.testing.assert_allclose(
        run.theta[~first], rest * (1.0 - swing[~first]) - 1.5 * rest * (1.0 - response), atol=2e-9
    )
