"""The native engine and FMPy's CVode agree on the same problems."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fmpy_oracle import FmpySimulator
from runs import ran

from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model

pytestmark = pytest.mark.fast

TIGHT = SolverSettings(1e-8, 1e-8)


def compare(problem: Problem, values: np.ndarray, pool, active=None, slack: float = 1.0) -> float:
    """Compare outputs and sensitivities; the largest difference of outputs over their ranges."""
    with open_simulator(problem, pool=pool) as native, FmpySimulator(problem) as reference:
        a, b = native.simulate(values, active=active), reference.simulate(values, active=active)
    assert np.all(a.outcomes == Outcome.OK)
    assert np.all(b.outcomes == Outcome.OK)
    largest = max(
        float(np.max(np.abs(x - y) / (np.ptp(y, axis=1, keepdims=True) + 1e-3)))
        for x, y in zip(a.outputs, b.outputs, strict=True)
    )
    for x, y in zip(a.outputs, b.outputs, strict=True):
        scale = np.ptp(y, axis=1, keepdims=True) + 1e-3
        np.testing.assert_allclose(x / scale, y / scale, atol=slack * 1e-6)
    if active is None:
        return largest
    for s, r, y in zip(a.sensitivities or (), b.sensitivities or (), b.outputs, strict=True):
        unit = np.ptp(y, axis=1, keepdims=True)[..., None] / np.abs(values[:, None, None, list(active)])
        scale = np.abs(r).max(axis=1, keepdims=True) + 1e-2 * unit  # differences see noise where nothing depends
        np.testing.assert_allclose(s / scale, r / scale, atol=slack * 1e-4)
    return largest


def test_test_models(test_fmu, here, drive, trust):
    time = np.linspace(0.0, 2.0, 57)
    for name, outputs, targets, values in (
        ("VanDerPol", ("x0", "x1"), (ParameterTarget("mu"), StartTarget("x1")), [[2.0, 0.3]]),
        ("BouncingBall", ("h", "v"), (ParameterTarget("e"),), [[0.6]]),
        ("Stair", ("counter", "x"), (ParameterTarget("kick"),), [[0.4]]),
        ("Circuit", ("i0", "v2", "power"), (ParameterTarget("R"), ParameterTarget("C")), [[8.0, 2e-3]]),
    ):
        model = test_fmu(name)
        inputs = drive(time) if model.inputs else ()
        problem = Problem(model, (Experiment(time + 1e-4, outputs, inputs),), (targets,), settings=TIGHT)
        trust("cvode", compare(problem, np.array(values), here, slack=10.0 if model.event_indicators else 1.0))


def test_directional_derivatives_that_leave_parameters_out_are_not_used(test_fmu, here):
    time = np.linspace(0.0, 2.0, 57)
    targets = (ParameterTarget("mu"), StartTarget("x1"))
    found = []
    for defines in ((), ("ONLY_STATES",)):
        problem = Problem(
            test_fmu("VanDerPol", defines=defines), (Experiment(time, ("x0", "x1")),), (targets,), settings=TIGHT
        )
        found.append(ran(problem, here, [2.0, 0.3], active=[0, 1]).sensitivities[0])
    np.testing.assert_allclose(found[1], found[0], atol=1e-6 * np.abs(found[0]).max())


@pytest.mark.parametrize("drive", ["rare jumps", "held samples"], indirect=True)
def test_inputs_that_may_be_set_at_events_only(test_fmu, here, drive):
    time = np.linspace(0.0, 2.0, 57)
    for name, output in (("Feedthrough", "y"), ("Circuit", "power")):
        model = test_fmu(name, defines=("HELD_INPUTS",))
        problem = Problem(model, (Experiment(time, (output,), drive(time)),), ((),), settings=TIGHT)
        compare(problem, np.zeros((1, 0)), here)


@pytest.fixture(scope="module", params=["rare jumps", "held samples", "straight lines"])
def aero_problem(aero: Model, request: pytest.FixtureRequest) -> tuple[Problem, np.ndarray]:
    rng = np.random.default_rng(1)
    time = np.linspace(0.0, 4.0, 201)
    outputs = ("i_m", "omega_m", "theta")
    measured = rng.standard_normal((201, 3))
    measured[rng.uniform(size=measured.shape) < 0.1] = np.nan
    held = InputSignal("V_m", np.array([-1.0, 0.0, 2.0]), np.array([0.0, 24.0, 5.0]))
    ramp = InputSignal("V_m", np.array([0.0, 1.0, 2.5]), np.array([0.0, 24.0, 5.0]), "linear")
    if request.param != "rare jumps":  # few samples, since the reference restarts at each
        time, measured = time[:16], measured[:16]
        level = 12.0 + 6.0 * rng.standard_normal(time.size)
        held = InputSignal("V_m", time, level, "hold" if request.param == "held samples" else "linear")
    experiments = (
        Experiment(time, outputs, (held,), {"theta": 0.1}, measured),
        Experiment(np.sort(rng.uniform(0.0, 3.0, 100)), ("theta",), (ramp,), measured=rng.standard_normal((100, 1))),
    )
    names = ("R_a", "c_m", "J_r", "k_t")
    targets = (*(ParameterTarget(n) for n in names), StartTarget("theta"), DelayTarget())
    values = np.array([[*(model_start(aero, n) for n in names), 0.1, 0.0061]])
    return Problem(aero, experiments, (targets, targets), settings=TIGHT), values


def model_start(model: Model, name: str) -> float:
    start = model.parameter(name).start
    assert start is not None
    return start


def test_aero_trajectories_and_sensitivities(aero_problem, here):
    problem, values = aero_problem
    compare(problem, values, here, active=[0, 1, 2, 3, 5])


def test_aero_within_a_hundred_thousandth_of_the_range(aero, here):
    time = np.linspace(0.0, 40.0, 2001)
    signal = InputSignal("V_m", np.array([0.0, 20.0]), np.array([24.0, 0.0]))
    assert_within_a_hundred_thousandth(aero, here, time, signal, SolverSettings(1e-11, 1e-11))


def test_aero_whose_voltage_moves_within_a_hundred_thousandth_of_the_range(aero, here, drive):
    time = np.linspace(0.0, 8.0, 401)
    (signal,) = drive(time)
    signal = replace(signal, name="V_m", values=6.0 * signal.values)
    assert_within_a_hundred_thousandth(aero, here, time, signal, SolverSettings(1e-10, 1e-10, max_steps=10_000_000))


def assert_within_a_hundred_thousandth(aero, here, time, signal, exact):
    experiment = Experiment(time, ("i_m", "omega_m", "theta"), (signal,))
    runs = []
    for settings in (SolverSettings(), exact):
        runs.append(ran(Problem(aero, (experiment,), ((),), settings=settings), here).outputs[0][0])
    assert np.all(np.abs(runs[0] - runs[1]).max(axis=0) < 1e-5 * np.ptp(runs[1], axis=0))
