"""FMUs with co-simulation only: run by FMPy in workers, slowly and as well as their own solver can."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from test_engine_isolation import CRASH, FAIL, FINE, HANG, NOT_A_NUMBER

from aero_bayes.errors import InputError
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
from aero_bayes.simulation.native_simulator import NativeSimulator

TIME = np.linspace(0.0, 2.0, 41)


def driven(model: Model) -> Problem:
    signals = (InputSignal("u", np.array([0.0, 0.713]), np.array([0.0, 2.0])),)
    experiment = Experiment(TIME, ("x", "y"), signals, measured=np.zeros((41, 2)))
    return Problem(model, (experiment,), ((ParameterTarget("k"), ParameterTarget("b")),))


@pytest.mark.parametrize("version", [2, 3])
def test_agrees_with_the_closed_form_and_the_native_engine(test_fmu, here, version):
    defines = ("FMI3", "STEPS") if version == 3 else ("STEPS",)
    model = test_fmu("Dahlquist", defines=defines)
    assert model.interface == "co-simulation"
    values = np.array([[1.3, 0.7], [0.9, 0.5]])
    with pytest.warns(UserWarning, match="co-simulation only"):
        steps = open_simulator(driven(model), workers=1)
    with warnings.catch_warnings(), steps, NativeSimulator(driven(test_fmu("Dahlquist")), pool=here) as native:
        warnings.simplefilter("ignore")
        found, expected = (s.simulate(values, active=[1, 0]) for s in (steps, native))
    assert np.all(found.outcomes == Outcome.OK)
    late = np.where(TIME > 0.713, TIME - 0.713, 0.0)
    for row, (k, b) in enumerate(values):
        x = np.exp(-k * TIME) + 2.0 * b / k * (1.0 - np.exp(-k * late))
        np.testing.assert_allclose(found.outputs[0][row, :, 0], x, atol=1e-4)
    for a, b in zip(found.sensitivities, expected.sensitivities, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-3)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_trouble_costs_its_own_run(test_fmu):
    model = test_fmu("Trouble", defines=("STEPS",))
    settings = SolverSettings(time_limit=0.3)
    problem = Problem(model, (Experiment(TIME, ("x",)),), ((ParameterTarget("mode"),),), settings=settings)
    modes = [FINE, CRASH, FINE, HANG, FAIL, NOT_A_NUMBER, FINE]
    with open_simulator(problem, workers=1) as simulator:
        found = simulator.simulate(np.array(modes, dtype=float)[:, None])
    expected = [Outcome.OK, Outcome.CRASHED, Outcome.OK, Outcome.TIMED_OUT, Outcome.MODEL_ERROR, Outcome.NOT_FINITE]
    assert [Outcome(o) for o in found.outcomes[:, 0]] == [*expected, Outcome.OK]
    good = found.outcomes[:, 0] == Outcome.OK
    np.testing.assert_allclose(found.outputs[0][good, :, 0], np.exp(-TIME)[None].repeat(3, axis=0), atol=1e-4)


def test_a_solver_that_does_not_converge_is_said(test_fmu):
    # Euler's method in 64 x 20 steps over 40 time constants errs by far more than is asked for
    model = test_fmu("Dahlquist", defines=("STEPS",))
    problem = Problem(model, (Experiment(np.array([0.0, 20.0, 40.0]), ("x",)),), ((),), {"a": 1.0, "w": 5.0})
    with pytest.warns(UserWarning, match="co-simulation only"):
        simulator = open_simulator(problem, workers=1)
    with simulator, pytest.warns(UserWarning, match="not accurate"):
        simulator.simulate(np.zeros((1, 0)))


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_it_cannot_do_is_named(test_fmu):
    problem = driven(test_fmu("Dahlquist", defines=("STEPS",)))
    with pytest.raises(InputError, match="no Model Exchange"):
        NativeSimulator(problem, workers=1)
    starts = replace(problem, targets=((StartTarget("x"), None),))
    with pytest.raises(InputError, match="initial state"):
        open_simulator(starts)
    rigid = replace(problem, model=replace(problem.model, takes_any_step=False))
    with pytest.raises(InputError, match="delay"):
        open_simulator(replace(rigid, targets=((DelayTarget(), None),)))


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("named", [0.05, None])
def test_steps_of_one_size_follow_the_fmu_and_not_the_readings_that_are_left(test_fmu, named):
    model = replace(test_fmu("Dahlquist", defines=("STEPS", "ONE_SIZE")), step_size=named)
    signals = (InputSignal("u", np.array([0.0, 0.7]), np.array([0.0, 2.0])),)
    whole = Experiment(TIME, ("x", "y"), signals)
    few = whole.at_samples(np.array([0, 3, 10, 11, 40]))
    found = []
    for experiment in (whole, few):
        with open_simulator(Problem(model, (experiment,), ((ParameterTarget("k"),),)), workers=1) as simulator:
            found.append(simulator.simulate(np.array([[1.3]])).outputs[0][0])
    np.testing.assert_allclose(found[1], found[0][[0, 3, 10, 11, 40]], rtol=1e-12)


@pytest.mark.parametrize(
    ("defines", "near"),
    [
        (("STEPS",), 1e-4),
        (("FMI3", "STEPS"), 1e-4),
        (("STEPS", "ONE_SIZE", "SLOPES"), 3e-3),  # by Euler's 20 steps a sample, which cannot be made smaller
        (("STEPS", "ONE_SIZE"), 0.12),  # half a sample late, and said to be
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_output_that_a_moving_input_feeds_directly_is_not_late(test_fmu, defines, near):
    # u rises by 1.5 a second from 0.5 s on; x' = u - x from rest; y = 2 x + 3 u
    model = test_fmu("Dahlquist", defines=defines)
    assert (model.interpolates_inputs, model.takes_any_step) == ("SLOPES" in defines, "ONE_SIZE" not in defines)
    ramp = (InputSignal("u", np.array([0.0, 0.5, 2.0]), np.array([0.0, 0.0, 2.25]), "linear"),)
    problem = Problem(model, (Experiment(TIME, ("x", "y"), ramp),), ((ParameterTarget("g"),),))
    with open_simulator(problem, workers=1) as simulator:
        found = simulator.simulate(np.array([[1e-12]])).outputs[0][0]  # x(0)
    late = np.maximum(TIME - 0.5, 0.0)
    x = 1.5 * (late - 1.0 + np.exp(-late))
    y = 2.0 * x + 4.5 * late
    np.testing.assert_allclose(found, np.stack([x, y], axis=1), atol=near)
    if defines == ("STEPS", "ONE_SIZE"):
        with pytest.warns(UserWarning, match=r"\bu\b.* half a sampling interval"):
            open_simulator(problem, workers=1).close()
