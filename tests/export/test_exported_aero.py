"""The exported benches against a hand-written ODE and against the FMI standard."""

from __future__ import annotations

import ctypes
import hashlib
import zipfile
from collections.abc import Callable
from pathlib import Path

import casadi
import fmpy
import numpy as np
import pytest
from export_driver import Driven, driven
from fmpy.validation import validate_fmu
from hand_written_aero import NOMINAL, SCALES, TWO_DOF_NOMINAL, TWO_DOF_SCALES, motor, one_dof

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.model import Model

Built = Callable[[str], Path]
SYSTEMS = ("OneDof", "HalfQuad", "OneDofLinear", "HalfQuadLinear", "TransferFunction", "TwoDof")
X = np.array([0.3, 200.0, 0.1, 0.2, -0.2, -150.0])


def draw(rng: np.random.Generator, nominal: dict[str, float] = NOMINAL) -> dict[str, float]:
    return {n: v * float(rng.uniform(0.5, 2.0)) for n, v in nominal.items()}


@pytest.mark.parametrize("name", SYSTEMS)
def test_validates_without_a_complaint(aero_fmu, name):
    assert validate_fmu(str(aero_fmu(name))) == []


@pytest.mark.parametrize("name", ["OneDof", "HalfQuad", "OneDofLinear", "HalfQuadLinear"])
def test_rates_equal_the_hand_written_equations(aero_fmu, name):
    rng = np.random.default_rng(1)
    with driven(aero_fmu(name)) as fmu:
        fmu.begin()
        for _ in range(50):
            p, v = draw(rng), float(rng.uniform(-24, 24))
            x = {s: float(rng.normal()) * SCALES[s] for s in fmu.states}
            fmu.set_all(p | {"V_m": v})
            rates = one_dof(x, v, p, linear=name.endswith("Linear"))
            expected = np.array([rates[s] for s in fmu.states])
            found = fmu.rhs(np.array(list(x.values())))
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def test_free_in_pitch_and_yaw_it_follows_from_its_kinetic_energy(aero_fmu):
    """Euler and Lagrange: the rotors' angular momenta follow the axes, the thrusts push across the arms."""
    rng = np.random.default_rng(2)
    q, dq, ddq = casadi.SX.sym("q", 2), casadi.SX.sym("dq", 2), casadi.SX.sym("ddq", 2)
    spin, dspin = casadi.SX.sym("spin", 2), casadi.SX.sym("dspin", 2)
    # the main rotor turns about an axis that is tilted by the pitch, the tail rotor against the pitch axis
    about_axis = casadi.vertcat(dq[1] * casadi.cos(q[0]), -dq[0])
    with driven(aero_fmu("TwoDof")) as fmu:
        assert {n: fmu.starts[n] for n in fmu.parameters} == TWO_DOF_NOMINAL
        fmu.begin()
        for _ in range(20):
            p, x = draw(rng, TWO_DOF_NOMINAL), {s: float(rng.normal()) * TWO_DOF_SCALES[s] for s in fmu.states}
            u = {"V_m": float(rng.uniform(-24, 24)), "V_t": float(rng.uniform(-24, 24))}
            fmu.set_all(p | u)
            rates = dict(zip(fmu.states, fmu.rhs(np.array(list(x.values()))), strict=True))
            thrust, drag = [], []
            for m, own in (("m", p), ("t", p | {"k_d": p["k_dt"], "k_t": p["k_tt"]})):
                i, w = f"thruster_{m}.motor.inductor.i", f"omega_{m}"
                *expected, force = motor(x[i], x[w], u[f"V_{m}"], own)
                assert [rates[i], rates[w]] == pytest.approx(expected, rel=1e-12)
                thrust.append(force)
                drag.append(own["k_d"] * x[w] * abs(x[w]))
            energy = 0.5 * p["J_p"] * dq[0] ** 2 + 0.5 * (p["J_y"] - p["J_p"] * casadi.sin(q[0]) ** 2) * dq[1] ** 2
            lagrangian = energy + (p["J_r"] + p["J_s"]) * casadi.dot(spin, about_axis) + p["K_sp"] * casadi.cos(q[0])
            momentum = casadi.gradient(lagrangian, dq)
            forces = casadi.vertcat(
                p["D_t"] * thrust[0] - p["D_p"] * dq[0],
                p["D_t"] * casadi.cos(q[0]) * thrust[1] - p["D_y"] * dq[1],
            ) - casadi.jtimes(about_axis, dq, casadi.DM.eye(2)).T @ casadi.DM(drag)
            change = sum(casadi.jtimes(momentum, of, by) for of, by in ((q, dq), (dq, ddq), (spin, dspin)))
            left = change - casadi.gradient(lagrangian, q) - forces
            balance = casadi.Function("f", [q, dq, ddq, spin, dspin], [left])(
                [x["theta"], x["psi"]], [x["body.omega"], x["body.rate"]], [rates["body.omega"], rates["body.rate"]],
                [x["omega_m"], x["omega_t"]], [rates["omega_m"], rates["omega_t"]],
            )  # fmt: skip
            assert (rates["theta"], rates["psi"]) == (x["body.omega"], x["body.rate"])
            np.testing.assert_allclose(np.array(balance).ravel(), 0.0, atol=1e-12)


def test_transfer_function_is_the_linear_oscillator(aero_fmu):
    with driven(aero_fmu("TransferFunction")) as fmu:
        fmu.begin()
        fmu.set(K_pp=0.002, J_p=0.03, D_p=0.01, K_sp=0.05, V_m=7.0)
        by_name = dict(zip(fmu.states, fmu.rhs(np.array([0.3, -0.2])), strict=True))
    assert by_name["theta"] == -0.2
    assert by_name["body.omega"] == pytest.approx((0.002 * 7.0 - 0.01 * -0.2 - 0.05 * 0.3) / 0.03, rel=1e-13)


def test_defaults_are_the_nominal_values(aero_fmu):
    with driven(aero_fmu("OneDof")) as fmu:
        assert set(fmu.parameters) == set(NOMINAL)
        assert {n: fmu.starts[n] for n in NOMINAL} == NOMINAL
        for v in fmu.description.modelVariables:
            if v.causality == "parameter":
                assert v.variability == "tunable"
                assert v.unit
                assert float(v.min) < float(v.start) < float(v.max)
                assert v.nominal
                assert v.description


@pytest.mark.parametrize("name", ["OneDof", "HalfQuad", "TwoDof"])
def test_directional_derivatives_equal_differences(aero_fmu, name):
    rng = np.random.default_rng(2)
    two = name == "TwoDof"
    with driven(aero_fmu(name)) as fmu:
        fmu.begin()
        p = draw(rng, TWO_DOF_NOMINAL) | {"V_m": 11.0, "V_t": -7.0} if two else draw(rng) | {"V_m": 11.0}
        scales = np.array([(TWO_DOF_SCALES if two else SCALES)[s] for s in fmu.states])
        x = rng.normal(size=len(scales)) * scales
        fmu.set_all(p)
        for state, step in zip(fmu.states, 1e-6 * np.diag(scales), strict=True):
            expected = (fmu.rhs(x + step) - fmu.rhs(x - step)) / (2 * step.max())
            fmu.move(x)
            np.testing.assert_allclose(fmu.slope(fmu.rates, state), expected, rtol=1e-6, atol=1e-5)
        for known, value in p.items():
            h = 1e-6 * abs(value)
            ends = []
            for sign in (1, -1):
                fmu.set_all({known: value + sign * h})
                ends.append(fmu.rhs(x))
            fmu.set_all({known: value})
            expected = (ends[0] - ends[1]) / (2 * h)
            found = fmu.slope(fmu.rates, known)
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
        assert fmu.slope(["theta"], "theta") == [1.0]
        assert fmu.slope(["theta"], "K_sp") == [0.0]


def test_outputs_share_the_references_of_the_states(aero_fmu):
    with driven(aero_fmu("OneDof")) as fmu:
        assert fmu.states[:3] == ["i_m", "omega_m", "theta"]
        assert fmu.references["theta"] == fmu.references["body.theta"]
        fmu.set(theta=0.25)
        fmu.begin()
        assert fmu.get("theta", "body.theta").tolist() == [0.25, 0.25]
        assert dict(zip(fmu.states, fmu.position(), strict=True))["theta"] == 0.25
        nominals = (ctypes.c_double * 6)()
        fmu.fmu.getNominalsOfContinuousStates(nominals, 6)
        assert dict(zip(fmu.states, nominals, strict=True))["omega_m"] == 100.0


def test_state_survives_a_round_trip(aero_fmu):
    with driven(aero_fmu("OneDof")) as fmu:
        fmu.begin()
        fmu.set(V_m=9.0, R_a=7.7)
        rates = fmu.rhs(X)
        saved = fmu.fmu.getFMUState()
        stored = fmu.fmu.serializeFMUState(saved)
        fmu.set(V_m=-3.0, R_a=9.9)
        for state in (saved, fmu.fmu.deSerializeFMUstate(stored)):
            assert not np.array_equal(fmu.rhs(0 * X), rates)
            fmu.fmu.setFMUState(state)
            assert np.array_equal(fmu.position(), X)
            assert np.array_equal(fmu.get(*fmu.rates), rates)
            fmu.fmu.freeFMUState(state)
        with driven(aero_fmu("HalfQuad")) as other:
            other.begin()
            with pytest.raises(Exception, match="fmi2DeSerializeFMUstate"):
                other.fmu.deSerializeFMUstate(stored)


def test_reset_returns_to_the_beginning_of_one_instance(aero_fmu):
    with driven(aero_fmu("OneDof")) as fmu:
        two = Driven(aero_fmu("OneDof"), fmu.folder)
        fmu.begin()
        two.begin()
        first = fmu.rhs(X)
        two.rhs(X)
        fmu.set(R_a=20.0, V_m=5.0)
        fmu.rhs(0 * X)
        assert np.array_equal(two.get(*two.rates), first)  # instances share nothing
        two.fmu.freeInstance()
        fmu.fmu.reset()
        assert fmu.get("R_a", "V_m").tolist() == [NOMINAL["R_a"], 0.0]
        fmu.begin()
        assert np.array_equal(fmu.position(), np.zeros(6))
        assert np.array_equal(fmu.rhs(X), first)


def test_what_cannot_be_set_is_refused(aero_fmu):
    with driven(aero_fmu("OneDof")) as fmu:
        fmu.begin()
        with pytest.raises(Exception, match="fmi2SetReal"):
            fmu.set_all({"der(theta)": 1.0})


def test_a_state_set_by_reference_while_running_is_the_state(aero_fmu):
    with driven(aero_fmu("OneDof")) as fmu:
        fmu.begin()
        before = fmu.get("der(body.omega)")
        fmu.set_all({"theta": 0.125})
        assert np.count_nonzero(fmu.position() == 0.125) == 1
        pull = fmu.get("K_sp") * 0.125 / fmu.get("J_p")
        assert fmu.get("der(body.omega)") - before == pytest.approx(-pull, rel=1e-12)


def test_two_builds_are_the_same_bytes(aero_fmu, tmp_path):
    again = export_fmu("Aero.Systems.OneDof", tmp_path / "other name.fmu", compiler="embedded")
    first = aero_fmu("OneDof").read_bytes()
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(first).digest()
    with zipfile.ZipFile(again) as archive:
        assert {i.date_time for i in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        library = archive.read("binaries/linux64/Aero_Systems_OneDof.so")
    assert str(tmp_path).encode() not in library


def test_units_have_their_base_units(aero_fmu):
    description = fmpy.read_model_description(str(aero_fmu("OneDof")))
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    volt = units["V"]
    assert (volt.kg, volt.m, volt.s, volt.A, volt.rad) == (1, 2, -3, -1, 0)
    thrust = units["N.s2/rad2"]
    assert (thrust.kg, thrust.m, thrust.s, thrust.rad) == (1, 1, 0, -2)
    assert all(base is not None for base in units.values())


@pytest.mark.parametrize("name", ["OneDof", "HalfQuad"])
def test_listed_dependencies_are_those_of_the_derivatives(aero_fmu, name):
    model = Model.load(aero_fmu(name))
    assert model.jacobian_pattern is not None
    with driven(aero_fmu(name)) as fmu:
        fmu.begin()
        fmu.move(np.random.default_rng(3).uniform(0.2, 1.0, len(fmu.states)))
        for state, rows in zip(fmu.states, model.jacobian_pattern, strict=True):
            assert {i for i, slope in enumerate(fmu.slope(fmu.rates, state)) if slope} == set(rows)


def test_an_event_is_asked_for_only_where_an_input_jumps(aero_fmu):
    """An input that moves with time at each evaluation, as other masters move it, needs none."""
    path = aero_fmu("OneDof")
    assert not Model.load(path).wants_step_callback  # the engines make an event of each jump themselves
    with driven(path) as fmu:
        fmu.begin()
        x = np.zeros(len(fmu.states))
        for t in np.linspace(0.0, 0.1, 11):
            fmu.set(V_m=float(np.sin(t)))
            fmu.rhs(x, t)
        assert fmu.fmu.completedIntegratorStep() == (0, 0)
        for t in (0.1, 0.11, 0.12):
            fmu.rhs(x, t)
        fmu.set(V_m=3.0)
        assert fmu.fmu.completedIntegratorStep() == (1, 0)
        assert fmu.fmu.completedIntegratorStep() == (0, 0)
