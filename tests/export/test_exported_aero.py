"""The exported benches against a hand-written ODE and against the FMI standard."""

from __future__ import annotations

import ctypes
import hashlib
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import fmpy
import numpy as np
import pytest
from export_driver import Driven, driven
from fmpy.validation import validate_fmu
from hand_written_aero import NOMINAL, SCALES, STATES, half_quad, one_dof
from scipy.integrate import solve_ivp

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.interface import Experiment, InputSignal, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator

Built = Callable[[str], Path]
SYSTEMS = ("OneDof", "HalfQuad", "OneDofLinear", "HalfQuadLinear", "TransferFunction")


def rates_by_hand(name: str, states: list[str], x: np.ndarray, v: float, p: dict[str, float]) -> np.ndarray:
    function = one_dof if name.startswith("OneDof") else half_quad
    own = [STATES.index(s) for s in states]
    ordered = np.zeros(len(states))
    ordered[np.argsort(np.argsort(own))] = x
    by_name = dict(zip(states, x, strict=True))
    ordered = np.array([by_name[s] for s in STATES if s in by_name])
    rates = function(ordered, v, p, linear=name.endswith("Linear"))
    return np.array([rates[s] for s in states])


def draw(rng: np.random.Generator) -> dict[str, float]:
    return {n: v * float(rng.uniform(0.5, 2.0)) for n, v in NOMINAL.items()}


@pytest.mark.parametrize("name", SYSTEMS)
def test_validates_without_a_complaint(aero_fmu, name):
    assert validate_fmu(str(aero_fmu(name))) == []


@pytest.mark.parametrize("name", ["OneDof", "HalfQuad", "OneDofLinear", "HalfQuadLinear"])
def test_rates_equal_the_hand_written_equations(aero_fmu, name):
    rng = np.random.default_rng(1)
    with driven(aero_fmu(name)) as fmu:
        fmu.begin()
        for _ in range(50):
            p = draw(rng)
            v = float(rng.uniform(-24, 24))
            x = np.array([rng.normal() * SCALES[STATES.index(s)] for s in fmu.states])
            fmu.set_all(p | {"V_m": v})
            expected = rates_by_hand(name, fmu.states, x, v, p)
            np.testing.assert_allclose(fmu.rhs(x), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


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


@pytest.mark.parametrize("name", ["OneDof", "HalfQuad"])
def test_directional_derivatives_equal_differences(aero_fmu, name):
    rng = np.random.default_rng(2)
    with driven(aero_fmu(name)) as fmu:
        fmu.begin()
        p = draw(rng) | {"V_m": 11.0}
        x = np.array([rng.normal() * SCALES[STATES.index(s)] for s in fmu.states])
        fmu.set_all(p)
        for j, state in enumerate(fmu.states):
            h = 1e-6 * SCALES[STATES.index(state)]
            step = np.eye(len(x))[j] * h
            expected = (fmu.rhs(x + step) - fmu.rhs(x - step)) / (2 * h)
            fmu.move(x)
            np.testing.assert_allclose(fmu.slope(fmu.rates, state), expected, rtol=1e-6, atol=1e-5)
        for known, value in p.items():
            h = 1e-6 * value
            fmu.set_all({known: value + h})
            above = fmu.rhs(x)
            fmu.set_all({known: value - h})
            below = fmu.rhs(x)
            fmu.set_all({known: value})
            expected = (above - below) / (2 * h)
            np.testing.assert_allclose(
                fmu.slope(fmu.rates, known), expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max()
            )
        assert fmu.slope(["theta"], "theta") == [1.0]
        assert fmu.slope(["theta"], "K_sp") == [0.0]


def test_directional_derivative_is_linear_in_the_seed(aero_fmu):
    with driven(aero_fmu("OneDof")) as fmu:
        fmu.begin()
        fmu.move(np.array([0.3, 200.0, 0.1, 0.2, -0.2, -150.0]))
        known = ["V_m", "R_a", "theta"]
        seeds = [0.3, -2.0, 0.7]
        together = fmu.fmu.getDirectionalDerivative(
            [fmu.references[n] for n in fmu.rates], [fmu.references[n] for n in known], seeds
        )
        apart = sum(s * fmu.slope(fmu.rates, n) for s, n in zip(seeds, known, strict=True))
        np.testing.assert_allclose(together, apart, rtol=1e-14)


def reference_run(v_of_t: Callable[[float], float], jumps: list[float], grid: np.ndarray) -> np.ndarray:
    """i_m, omega_m, theta of the nominal OneDof on ``grid`` (n, 3), from the hand-written equations."""
    found = np.zeros((len(grid), 3))
    x = np.zeros(6)
    for start, end in pairwise(jumps):
        v = v_of_t(0.5 * (start + end))
        here = (grid >= start) & (grid <= end)
        solution = solve_ivp(
            lambda t, x, v=v: np.array([one_dof(x, v, NOMINAL)[s] for s in STATES]),
            (start, end), x, method="Radau", t_eval=np.union1d(grid[here], [end]), rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        x = solution.y[:, -1]
        found[here] = solution.y[:3, np.isin(solution.t, grid[here])].T
    return found


@pytest.fixture(scope="module")
def step_by_hand() -> tuple[np.ndarray, np.ndarray]:
    """24 V for 4 s, then 0 V for 4 s: the grid, and the outputs on it."""
    grid = np.round(np.arange(0, 8.0001, 0.05), 10)
    return grid, reference_run(lambda t: 24.0 if t < 4 else 0.0, [0.0, 4.0, 8.0], grid)


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_trajectories_agree_with_the_hand_written_ode(aero_fmu, step_by_hand, kind):
    grid, expected = step_by_hand
    signal = np.array([(0, 24.0), (4, 24.0), (4, 0.0), (8, 0.0)], dtype=[("time", "f8"), ("V_m", "f8")])
    result = fmpy.simulate_fmu(
        str(aero_fmu("OneDof")), fmi_type=kind, input=signal, stop_time=8.0, output_interval=0.05,
        relative_tolerance=1e-9, output=["i_m", "omega_m", "theta"],
    )  # fmt: skip
    time, first = np.unique(np.round(result["time"], 9), return_index=True)
    keep = np.isin(time, grid) & (time != 4.0)
    assert keep.sum() == len(grid) - 1
    wanted = np.isin(grid, time[keep])
    for column, output in enumerate(("i_m", "omega_m", "theta")):
        scale = np.abs(expected[:, column]).max()
        np.testing.assert_allclose(result[output][first][keep], expected[wanted, column], atol=1e-6 * scale, rtol=1e-6)


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
        x = np.array([0.3, 200.0, 0.1, 0.2, -0.2, -150.0])
        fmu.set(V_m=9.0, R_a=7.7)
        rates = fmu.rhs(x)
        saved = fmu.fmu.getFMUState()
        stored = fmu.fmu.serializeFMUState(saved)
        fmu.set(V_m=-3.0, R_a=9.9)
        assert not np.array_equal(fmu.rhs(0 * x), rates)
        fmu.fmu.setFMUState(saved)
        assert np.array_equal(fmu.position(), x)
        assert np.array_equal(fmu.get(*fmu.rates), rates)
        fmu.fmu.freeFMUState(saved)
        fmu.rhs(0 * x)
        again = fmu.fmu.deSerializeFMUstate(stored)
        fmu.fmu.setFMUState(again)
        assert np.array_equal(fmu.get(*fmu.rates), rates)
        fmu.fmu.freeFMUState(again)


def test_a_foreign_state_is_refused(aero_fmu):
    with driven(aero_fmu("OneDof")) as one, driven(aero_fmu("HalfQuad")) as other:
        one.begin()
        other.begin()
        stored = one.fmu.serializeFMUState(one.fmu.getFMUState())
        with pytest.raises(Exception, match="fmi2DeSerializeFMUstate"):
            other.fmu.deSerializeFMUstate(stored)


def test_reset_returns_to_the_beginning(aero_fmu):
    with driven(aero_fmu("OneDof")) as fmu:
        fmu.begin()
        x = np.array([0.3, 200.0, 0.1, 0.2, -0.2, -150.0])
        first = fmu.rhs(x)
        fmu.set(R_a=20.0, V_m=5.0)
        fmu.rhs(x)
        fmu.fmu.reset()
        assert fmu.get("R_a", "V_m").tolist() == [NOMINAL["R_a"], 0.0]
        fmu.begin()
        assert np.array_equal(fmu.position(), np.zeros(6))
        assert np.array_equal(fmu.rhs(x), first)


def test_instances_do_not_share_anything(aero_fmu):
    with driven(aero_fmu("OneDof")) as one:
        two = Driven(aero_fmu("OneDof"), one.folder)
        one.begin()
        two.begin()
        x = np.array([0.3, 200.0, 0.1, 0.2, -0.2, -150.0])
        before = one.rhs(x)
        two.set(R_a=20.0, V_m=5.0)
        two.rhs(0 * x)
        assert np.array_equal(one.get(*one.rates), before)
        assert one.get("R_a")[0] == NOMINAL["R_a"]
        two.fmu.freeInstance()


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


@pytest.mark.parametrize("given", ["line", "held"])
def test_another_master_follows_a_voltage_that_moves(given, tmp_path, rng):
    """FMPy sets a continuous input between two steps of CVode: it jumps there, and CVode has to begin anew."""
    path = export_fmu("Aero.Systems.OneDof", tmp_path / "one.fmu", compiler="embedded")
    time = np.arange(101) * 0.02
    volts = np.round(8.0 + 6.0 * np.sin(3.0 * time) + rng.normal(0.0, 1.0, time.size), 3)
    rows = (np.repeat(time, 2)[1:], np.repeat(volts, 2)[:-1]) if given == "held" else (time, volts)
    signal = np.array(list(zip(*rows, strict=True)), dtype=[("time", float), ("V_m", float)])
    model = Model.load(path)
    experiment = Experiment(time, ("i_m", "omega_m", "theta"), (InputSignal("V_m", time, volts, "hold"),))
    problem = Problem(model, (experiment,), ((),), settings=SolverSettings(1e-9, 1e-9))
    with NativeSimulator(problem) as simulator:
        exact = simulator.simulate(np.zeros((1, 0))).outputs[0][0]
    for tolerance in (1e-4, 1e-5, 1e-6):
        found = fmpy.simulate_fmu(
            str(path), fmi_type="ModelExchange", input=signal, stop_time=2.0, output_interval=0.02,
            relative_tolerance=tolerance, record_events=False, output=["i_m", "omega_m", "theta"],
        )  # fmt: skip
        for k, name in enumerate(("i_m", "omega_m", "theta")):
            at = np.interp(time[1:-1], found["time"], found[name])
            error = np.max(np.abs(at - exact[1:-1, k])) / np.ptp(exact[:, k])
            assert error < 30.0 * tolerance


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
