"""Dry friction and brush drop with exact sign laws: closed forms, sticking, and a steep smooth stand-in."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulated_rigs.aero import Parameters, Truth, effect, even_times, simulate_truth
from simulated_rigs.designs import Levels

pytestmark = pytest.mark.long

P = Parameters()


def test_swing_loses_the_same_angle_every_half_turn() -> None:
    """An undamped swing under Coulomb friction loses 2 tau / K per half period and stops inside tau / K."""
    p = Parameters(D_p=0.0)
    tau, start = 1e-3, 0.5
    time = even_times(60.0, 200.0)
    run = simulate_truth(
        Truth("one_dof", p, (effect("pivot_coulomb_friction", tau_c=tau),)), Levels((), ()), time, start
    )
    band = tau / p.K_sp
    half = np.pi * np.sqrt(p.J_p / p.K_sp)
    amplitude, k = start, 0
    while amplitude > band:
        end = (k + 1) * half
        inside = time <= end
        segment = (time >= k * half) & inside
        centre = band * (-1.0) ** k
        expected = centre + (amplitude - band) * (-1.0) ** k * np.cos(np.pi * (time[segment] - k * half) / half)
        np.testing.assert_allclose(run.theta[segment], expected, atol=2e-7)
        amplitude, k = amplitude - 2.0 * band, k + 1
    assert k == 9  # the first half turn after which 0.5 - 2 k tau / K is within tau / K
    rest = run.theta[time > (k + 0.01) * half]
    assert rest.size > 1000
    assert np.ptp(rest) == 0.0
    assert rest[0] == pytest.approx((-1.0) ** k * amplitude, abs=2e-7)
    assert abs(rest[0]) <= band


def test_stuck_body_does_not_move_until_it_is_pushed_hard_enough() -> None:
    tau = 2e-3
    time = even_times(20.0, 100.0)
    ramp = Levels(tuple(np.arange(0.0, 20.0, 0.5)), tuple(np.arange(40) * 0.4))
    run = simulate_truth(Truth("one_dof", P, (effect("pivot_coulomb_friction", tau_c=tau),)), ramp, time)
    thrust = 2.0 * P.D_t * P.k_t * run.speed * np.abs(run.speed)
    first = int(np.argmax(thrust > tau))
    assert (run.theta[:first] == 0.0).all()
    assert run.theta[first + 20] > 1e-5


def test_rotor_sticks_below_its_friction_and_settles_above_it() -> None:
    tau = 1.5e-3
    truth = Truth("one_dof", P, (effect("rotor_coulomb_friction", tau_r=tau),))
    time = even_times(20.0, 100.0)
    hold = 0.95 * tau * P.R_a / P.c_m
    run = simulate_truth(truth, Levels((0.0,), (hold,)), time)
    assert (run.omega_m == 0.0).all()
    assert run.i_m[-1] == pytest.approx(hold / P.R_a, rel=1e-9)
    run = simulate_truth(truth, Levels((0.0, 10.0), (12.0, 0.0)), time)
    w = run.omega_m[990]
    assert run.i_m[990] * P.c_m == pytest.approx(P.k_d * w * w + tau, rel=1e-6)
    stopped = run.omega_m[time > 12.0]
    assert (stopped == 0.0).all()


def test_brush_drop_blocks_small_voltages_and_takes_its_share_of_others() -> None:
    truth = Truth("one_dof", P, (effect("brush_drop", V_b=0.8),))
    time = even_times(10.0, 100.0)
    assert (simulate_truth(truth, Levels((0.0,), (0.79,)), time).i_m == 0.0).all()
    run = simulate_truth(truth, Levels((0.0,), (-12.0,)), time)
    assert P.R_a * run.i_m[-1] + P.c_m * run.omega_m[-1] - 0.8 == pytest.approx(-12.0, rel=1e-6)
    # Released, the motor turns on with no current at all once its voltage is below the drop.
    run = simulate_truth(truth, Levels((0.0, 5.0), (3.0, 0.0)), time)
    coasting = (time > 5.0) & (P.c_m * run.omega_m < 0.79)
    assert coasting.sum() > 10
    assert (run.i_m[coasting] == 0.0).all()


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("brush_drop", {"V_b": 0.5}),
        ("rotor_coulomb_friction", {"tau_r": 8e-4}),
        ("pivot_coulomb_friction", {"tau_c": 1e-3}),
    ],
)
def test_against_a_steep_smooth_law(name: str, parameters: dict[str, float]) -> None:
    """tanh with a small width tends to the sign law; what is left is of the order of the width."""
    time = even_times(6.0, 100.0)
    design = Levels((0.0, 1.5, 3.0, 4.5), (10.0, -8.0, 12.0, 0.0))
    volts = design.volts(time)
    g = {"V_b": 0.0, "tau_r": 0.0, "tau_c": 0.0} | parameters
    widths = (5e-6, 0.02, 2e-4)

    def rates(t: float, s: np.ndarray, v: float) -> list[float]:
        i, w, th, q = s
        di = (v - g["V_b"] * np.tanh(i / widths[0]) - P.R_a * i - P.c_m * w) / P.L_a
        dw = (P.c_m * i - P.k_d * w * abs(w) - g["tau_r"] * np.tanh(w / widths[1])) / (P.J_r + P.J_s)
        torque = 2.0 * P.D_t * P.k_t * w * abs(w) - g["tau_c"] * np.tanh(q / widths[2]) - P.D_p * q - P.K_sp * th
        return [di, dw, q, torque / P.J_p]

    out, state = [np.zeros(4)], np.zeros(4)
    edges = [0, *(np.flatnonzero(np.diff(volts)) + 1).tolist(), time.size - 1]
    for first, last in pairwise(edges):
        span = time[first : last + 1]
        run = solve_ivp(rates, (span[0], span[-1]), state, "LSODA", span, args=(volts[first],), rtol=1e-8, atol=1e-9)
        out += list(run.y.T[1:])
        state = run.y[:, -1]
    smooth = np.array(out)
    truth = Truth("one_dof", P, (effect(name, **parameters),))
    exact = simulate_truth(truth, design, time)
    for ours, theirs in ((exact.i_m, smooth[:, 0]), (exact.omega_m, smooth[:, 1]), (exact.theta, smooth[:, 2])):
        assert np.abs(ours - theirs).max() < 2e-3 * np.ptp(theirs)
