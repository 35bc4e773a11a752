"""The AERO that is free in pitch and yaw, against equations by hand and those against its kinetic energy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi
import numpy as np
import pytest
from export_driver import driven
from fmpy.validation import validate_fmu
from hand_written_aero import TWO_DOF_NOMINAL, TWO_DOF_SCALES, two_dof

Built = Callable[[str], Path]


def draw(rng: np.random.Generator) -> dict[str, float]:
    return {n: v * float(rng.uniform(0.5, 2.0)) for n, v in TWO_DOF_NOMINAL.items()}


def somewhere(rng: np.random.Generator) -> dict[str, float]:
    return {n: float(rng.normal()) * size for n, size in TWO_DOF_SCALES.items()}


def voltages(rng: np.random.Generator) -> dict[str, float]:
    return {"V_m": float(rng.uniform(-24, 24)), "V_t": float(rng.uniform(-24, 24))}


def test_validates_and_shows_what_it_was_built_to_show(aero_fmu):
    assert validate_fmu(str(aero_fmu("TwoDof"))) == []
    with driven(aero_fmu("TwoDof")) as fmu:
        assert set(fmu.states) == set(TWO_DOF_SCALES)
        assert {n: fmu.starts[n] for n in fmu.parameters} == TWO_DOF_NOMINAL
        known = {v.name: v for v in fmu.description.modelVariables}
        assert [known[n].unit for n in ("omega_m", "omega_t", "theta", "psi")] == ["rad/s", "rad/s", "rad", "rad"]
        for name in ("V_m", "V_t"):
            assert (known[name].unit, float(known[name].min), float(known[name].max)) == ("V", -24.0, 24.0)


def test_rates_equal_the_hand_written_equations(aero_fmu):
    rng = np.random.default_rng(1)
    with driven(aero_fmu("TwoDof")) as fmu:
        fmu.begin()
        for _ in range(50):
            p, u, x = draw(rng), voltages(rng), somewhere(rng)
            fmu.set_all(p | u)
            rates = two_dof(x, u["V_m"], u["V_t"], p)
            expected = np.array([rates[s] for s in fmu.states])
            found = fmu.rhs(np.array([x[s] for s in fmu.states]))
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def test_hand_written_equations_are_those_of_the_kinetic_energy():
    """Euler and Lagrange: the rotors' angular momenta follow the axes, the thrusts push across the arms."""
    rng = np.random.default_rng(2)
    p, u, x = draw(rng), voltages(rng), somewhere(rng)
    rates = two_dof(x, u["V_m"], u["V_t"], p)
    inertia = p["J_r"] + p["J_s"]
    drag = {n: p[k] * x[n] * abs(x[n]) for n, k in (("omega_m", "k_d"), ("omega_t", "k_dt"))}
    thrust = {n: p[k] * x[n] * abs(x[n]) for n, k in (("omega_m", "k_t"), ("omega_t", "k_tt"))}
    q, dq, ddq = casadi.SX.sym("q", 2), casadi.SX.sym("dq", 2), casadi.SX.sym("ddq", 2)
    spin, dspin = casadi.SX.sym("spin", 2), casadi.SX.sym("dspin", 2)
    # the main rotor turns about an axis that is tilted by the pitch, the tail rotor against the pitch axis
    about_axis = casadi.vertcat(dq[1] * casadi.cos(q[0]), -dq[0])
    energy = 0.5 * p["J_p"] * dq[0] ** 2 + 0.5 * (p["J_y"] - p["J_p"] * casadi.sin(q[0]) ** 2) * dq[1] ** 2
    lagrangian = energy + inertia * casadi.dot(spin, about_axis) + p["K_sp"] * casadi.cos(q[0])
    momentum = casadi.gradient(lagrangian, dq)
    forces = casadi.vertcat(
        p["D_t"] * thrust["omega_m"] - p["D_p"] * dq[0],
        p["D_t"] * casadi.cos(q[0]) * thrust["omega_t"] - p["D_y"] * dq[1],
    ) - casadi.jtimes(about_axis, dq, casadi.DM.eye(2)).T @ casadi.DM([drag["omega_m"], drag["omega_t"]])
    change = sum(casadi.jtimes(momentum, of, by) for of, by in ((q, dq), (dq, ddq), (spin, dspin)))
    balance = casadi.Function("f", [q, dq, ddq, spin, dspin], [change - casadi.gradient(lagrangian, q) - forces])
    left = balance(
        [x["theta"], x["psi"]], [x["body.omega"], x["body.rate"]], [rates["body.omega"], rates["body.rate"]],
        [x["omega_m"], x["omega_t"]], [rates["omega_m"], rates["omega_t"]],
    )  # fmt: skip
    np.testing.assert_allclose(np.array(left).ravel(), 0.0, atol=1e-13)


def test_directional_derivatives_equal_differences(aero_fmu):
    rng = np.random.default_rng(3)
    with driven(aero_fmu("TwoDof")) as fmu:
        fmu.begin()
        known, x = draw(rng) | {"V_m": 11.0, "V_t": -7.0}, somewhere(rng)
        fmu.set_all(known)
        at = np.array([x[s] for s in fmu.states])
        for j, state in enumerate(fmu.states):
            h = 1e-6 * TWO_DOF_SCALES[state]
            step = h * np.eye(len(at))[j]
            expected = (fmu.rhs(at + step) - fmu.rhs(at - step)) / (2 * h)
            fmu.move(at)
            np.testing.assert_allclose(fmu.slope(fmu.rates, state), expected, rtol=1e-6, atol=1e-5)
        for name, value in known.items():
            h = 1e-6 * abs(value)
            fmu.set_all({name: value + h})
            above = fmu.rhs(at)
            fmu.set_all({name: value - h})
            expected = (above - fmu.rhs(at)) / (2 * h)
            fmu.set_all({name: value})
            found = fmu.slope(fmu.rates, name)
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("voltage", "state", "sign"), [("V_m", "theta", 1), ("V_m", "psi", -1), ("V_t", "psi", 1), ("V_t", "theta", 1)]
)
def test_each_motor_turns_the_body_the_way_that_is_documented(aero_fmu, voltage, state, sign):
    with driven(aero_fmu("TwoDof")) as fmu:
        fmu.begin()
        fmu.set_all({voltage: 24.0})
        x = np.zeros(len(fmu.states))
        for _ in range(20000):
            x = x + 1e-5 * fmu.rhs(x)
        assert sign * x[fmu.states.index(state)] > 0.0
