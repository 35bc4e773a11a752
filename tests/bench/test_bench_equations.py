"""The bench against two motors and a body integrated independently, and against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from simulated_aero import HALF_QUAD, KINDS, Levels, Parameters, Truth, effect, even_times, paper_step, simulate_truth
from simulated_aero.exponential import block
from simulated_aero.integrate import AeroIntegrator
from simulated_aero.rig import equations_of

pytestmark = pytest.mark.long

P = Parameters()
DESIGN = Levels((0.0, 1.0, 2.5, 4.0, 5.2, 6.0), (14.0, -9.0, 18.0, 18.0, -17.0, 4.0))
TIME = even_times(8.0, 100.0)

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
    start = AeroIntegrator(equations_of(truth)).rest_angle()
    states = reference(two_motors(P, 2, **parameters), DESIGN.volts(TIME), start)
    # Heating bends the stiff circuit itself; inflow couples the two blocks that the method treats apart.
    bound = {"winding_heating": 2e-6, "thrust_inflow_loss": 6e-7}.get(name, 2e-7)
    assert errors(truth, states, 10 if name == "speed_lag" else 1).max() < bound


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
def test_effects_vanish_with_their_magnitude(name: str) -> None:
    kind = KINDS[name]
    parameters = {key: high for key, (_, high) in kind.ranges.items()} | {kind.magnitude: 0.0}
    run, base = (
        simulate_truth(Truth(effects=(kind.truth(**parameters),)), DESIGN, TIME),
        simulate_truth(Truth(), DESIGN, TIME),
    )
    for output in ("i_m", "omega_m", "theta"):
        np.testing.assert_allclose(
            getattr(run, output), getattr(base, output), atol=2e-7 * np.ptp(getattr(base, output))
        )


@pytest.mark.parametrize("name", [name for name in KINDS if name != "supply_resistance"])
def test_effects_show_at_their_largest(name: str) -> None:
    kind = KINDS[name]
    parameters = {key: high for key, (_, high) in kind.ranges.items()}
    run, base = (
        simulate_truth(Truth(effects=(kind.truth(**parameters),)), DESIGN, TIME),
        simulate_truth(Truth(), DESIGN, TIME),
    )
    changes = [
        np.std(getattr(run, o) - getattr(base, o)) / np.ptp(getattr(base, o)) for o in ("i_m", "omega_m", "theta")
    ]
    mean = np.mean(run.i_m - base.i_m) / np.ptp(base.i_m), np.mean(run.theta - base.theta) / np.ptp(base.theta)
    assert max(*changes, *np.abs(mean)) > 3e-3


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


def test_free_swing_keeps_its_energy_without_damping() -> None:
    p = Parameters(D_p=0.0)
    plan = equations_of(Truth("one_dof", p))
    integrator = AeroIntegrator(plan)
    states = integrator.run(TIME, np.zeros(TIME.size), integrator.start(0.5))
    energy = 0.5 * p.J_p * states[:, 3] ** 2 + 0.5 * p.K_sp * states[:, 2] ** 2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-11)


def test_error_falls_with_the_step() -> None:
    volts = DESIGN.volts(TIME)
    states = reference(two_motors(P, 2), volts)
    found = []
    for step in (1e-2, 5e-3, 2.5e-3):
        plan = equations_of(Truth())
        plan.max_step = step
        integrator = AeroIntegrator(plan)
        ours = integrator.run(TIME, volts, integrator.start(0.0))[:, :3]
        theirs = states[:, [0, 1, 4]]
        found.append(float((np.abs(ours - theirs).max(axis=0) / np.ptp(theirs, axis=0)).max()))
    assert found[0] > 2.5 * found[1] > 6.0 * found[2]


@pytest.mark.parametrize("h", [1e-11, 1e-8, 1e-5, 1e-3, 2e-2])
@pytest.mark.parametrize(
    "a",
    [
        (-7241.0, -36.2, 5250.0, 0.0),
        (0.0, 1.0, -1.71, -0.32),
        (0.0, 0.0, 5250.0, 0.0),
        (-3.0, 1e-6, 0.0, -3.0),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_exponential_coefficients(a: tuple[float, float, float, float], h: float) -> None:
    """Against the augmented matrix exponential, whose first row of blocks holds h^k phi_k."""
    matrix = np.array(a).reshape(2, 2)
    big = np.zeros((8, 8))
    big[:2, :2] = matrix
    for k in range(3):
        big[2 * k : 2 * k + 2, 2 * k + 2 : 2 * k + 4] = np.eye(2)

    def functions(step: float) -> list[np.ndarray]:
        rows = expm(big * step)[:2]
        return [rows[:, 2 * k : 2 * k + 2] / step**k for k in range(4)]

    ours = block(a, h)
    p0, p1, p2, p3 = functions(h)
    q0, q1, *_ = functions(0.5 * h)
    expected = (p0, q0, 0.5 * h * q1, h * (p1 - 3 * p2 + 4 * p3), h * (2 * p2 - 4 * p3), h * (4 * p3 - p2))
    for ours_one, theirs in zip(
        (ours.whole, ours.half, ours.stage, ours.first, ours.middle, ours.last), expected, strict=True
    ):
        np.testing.assert_allclose(
            np.array(ours_one).reshape(2, 2), theirs, rtol=1e-6, atol=1e-11 * np.abs(theirs).max()
        )
