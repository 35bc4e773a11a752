"""FMUs that do as other tools' do: what they leave unsaid costs no right answer."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from fmpy_oracle import FmpySimulator
from runs import one_run, ran
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from test_engine_events import bounce

from aero_bayes.errors import InputError
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    Experiment,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool

pytestmark = pytest.mark.fast

TIGHT = SolverSettings(1e-9, 1e-9)
TIME = np.linspace(0.0, 3.0, 121)


def run(
    model: Model,
    outputs: tuple[str, ...],
    targets: tuple[ProblemTarget, ...] = (),
    values: tuple[float, ...] = (),
    pool: WorkerPool | None = None,
    **other: object,
) -> tuple[np.ndarray, np.ndarray]:
    problem = Problem(model, (Experiment(TIME, outputs, **other),), (targets,), settings=TIGHT)  # type: ignore[arg-type]
    return one_run(problem, pool, values)


def test_states_that_an_event_changes_without_saying_so(test_fmu, here):
    out, _ = run(test_fmu("BouncingBall", defines=("SILENT",)), ("h",), pool=here)
    np.testing.assert_allclose(out[:, 0], bounce(TIME, 1.0, 0.7), atol=1e-6)


@pytest.mark.parametrize("directional", [True, False])
def test_outputs_that_copy_states(test_fmu, here, directional):
    model = test_fmu("Copies", directional=directional)
    assert [model.copied_state(name) for name in ("h", "v", "scaled", "driven", "none")] == [0, 1, None, None, None]
    h, v, w = 0.3, -0.8, 2.0
    targets = (StartTarget("h"), StartTarget("v"), ParameterTarget("w"))
    names = ("h", "v", "clipped", "scaled")
    out, slopes = run(model, names, targets, (h, v, w), pool=here)
    c, s = np.cos(w * TIME), np.sin(w * TIME)
    exact = np.stack([h * c + v * s, v * c - h * s], axis=1)
    np.testing.assert_allclose(out[:, :2], exact, atol=1e-7)
    np.testing.assert_allclose(out[:, 2], np.maximum(exact[:, 1], 0.0), atol=1e-7)
    np.testing.assert_allclose(out[:, 3], exact[:, 1], atol=1e-7)
    by = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1), np.stack([exact[:, 1], -exact[:, 0]], 1) * TIME[:, None]])
    np.testing.assert_allclose(slopes[:, :2], by.transpose(1, 2, 0), atol=1e-5)
    with pytest.raises(InputError, match="no state 'scaled'"):
        Problem(model, (Experiment(TIME, ("h",)),), ((StartTarget("scaled"),),)) and run(
            model, ("h",), (StartTarget("scaled"),), (1.0,), pool=here
        )


def test_starts_by_the_output_are_those_by_the_state(test_fmu, here):
    model = test_fmu("Copies")
    by_output = run(model, ("h",), pool=here, start={"h": 0.25, "v": 0.1})[0]
    by_state = run(model, ("h",), pool=here, start={"_D_outputAlias_h": 0.25, "v_inside": 0.1})[0]
    np.testing.assert_array_equal(by_output, by_state)


def test_states_selected_while_the_model_runs_are_refused(test_fmu, here, tmp_path):
    model = test_fmu("Circle", directional=False)
    problem = Problem(model, (Experiment(TIME, ("x", "y")),), ((),))
    found = ran(problem, here)
    assert found.outcomes[0, 0] == Outcome.STATES_SELECTED_ANEW
    from test_model_load import replaced, rewrite

    path = rewrite(test_fmu("VanDerPol").path, tmp_path / "set.fmu", replaced(b'"x1"', b'"_D_STATESET1_x[1]"'))
    with pytest.raises(InputError, match=r"_D_STATESET1_x.*dynamic state selection"):
        Model.load(path)


def loop(z: float) -> float:
    return z + z**3


def test_algebraic_loops_solved_only_by_the_derivatives(test_fmu, here):
    def z(t: float, x: float) -> float:
        return float(brentq(lambda z: loop(z) - x - 0.5 * np.sin(t), -10.0, 10.0, xtol=1e-14))

    def falls(t: float, x: np.ndarray) -> float:
        return z(t, x[0]) - 0.2

    falls.terminal, falls.direction = True, -1.0  # type: ignore[attr-defined]
    expected = np.empty(TIME.size)
    begin, x = 0.0, 1.0
    while begin < TIME[-1]:
        piece = solve_ivp(
            lambda t, x: [-z(t, x[0])], (begin, TIME[-1]), [x], rtol=1e-10, atol=1e-12, events=falls, dense_output=True
        )
        end = piece.t[-1]
        inside = (begin <= TIME) & (end >= TIME)
        expected[inside] = [z(t, piece.sol(t)[0]) for t in TIME[inside]]
        begin, x = piece.t[-1], 1.0
    out, _ = run(test_fmu("Loop"), ("z",), pool=here)
    np.testing.assert_allclose(out[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("define", ["FIXED", "NOISY", "ONCE", "NO_RESET", "HELD_INPUTS"])
@pytest.mark.parametrize("directional", [True, False])
@pytest.mark.parametrize("drive", ["rare jumps", "held samples"], indirect=True)
def test_restrictions_change_no_number(test_fmu, here, pool, drive, define, directional):
    targets = (ParameterTarget("w"), StartTarget("h"))
    held = drive(TIME)
    plain, strict = (
        run(
            test_fmu("Copies", directional=directional, defines=d),
            ("h", "driven"),
            targets,
            (2.0, 0.7),
            pool=p,
            inputs=held,
        )
        for d, p in (((), here), ((define,), pool))
    )
    np.testing.assert_array_equal(strict[0], plain[0])
    np.testing.assert_array_equal(strict[1], plain[1])


def test_an_fmu_that_runs_once_a_process_is_an_outcome_not_a_wait(test_fmu, here):
    # the engine starts a model several times: to look at it, then to run it
    model = test_fmu("Copies", defines=("ONCE", "NO_RESET"))
    problem = Problem(model, (Experiment(TIME, ("clipped",)),), ((ParameterTarget("w"),),))
    with WorkerPool(1) as pool:
        for place in (here, pool):
            found = ran(problem, place, [[1.0], [2.0]])
            assert np.all(found.outcomes == Outcome.MODEL_ERROR)


@pytest.mark.parametrize("defines", [(), ("ALWAYS",)])
def test_a_callback_after_every_step_that_asks_for_events(test_fmu, here, defines):
    # x' = 1 - x + b cos(4 t) once t > 1: before it 1 - e^-t, after it with the particular solution of the forcing
    b = 0.7

    def forced(t: np.ndarray) -> np.ndarray:
        return b * (np.cos(4.0 * t) + 4.0 * np.sin(4.0 * t)) / 17.0

    late = TIME > 1.0
    exact = 1.0 - np.exp(-TIME)
    exact += np.where(late, forced(TIME) - forced(np.array(1.0)) * np.exp(-np.where(late, TIME - 1.0, 0.0)), 0.0)
    model = test_fmu("Stepping", defines=defines)
    out, slopes = run(model, ("x",), (ParameterTarget("b"),), (b,), pool=here)
    np.testing.assert_allclose(out[:, 0], exact, atol=1e-6)
    np.testing.assert_allclose(slopes[:, 0, 0], (exact - 1.0 + np.exp(-TIME)) / b, atol=1e-4)


def test_sensitivities_of_a_slope_that_a_state_event_changes(test_fmu, here):
    # v' = g, h' = v until h = 0, then both rest (e = 0): no state jumps but v; before the impact dh/dg = t^2 / 2
    targets = (ParameterTarget("g"),)
    _, slopes = run(test_fmu("BouncingBall", defines=("SILENT",)), ("h",), targets, (-1.0,), pool=here)
    before = TIME < 1.41
    np.testing.assert_allclose(slopes[before, 0, 0], 0.5 * TIME[before] ** 2, atol=1e-5)


def test_a_step_event_that_changes_the_state(test_fmu, here):
    model = test_fmu("Stepping")
    out, _ = run(model, ("x",), (ParameterTarget("ceiling"),), (0.5,), pool=here)
    assert out.max() < 0.75  # the step that passes the ceiling is the last before the event
    assert np.sum(np.diff(out[:, 0]) < -0.3) >= 2


def test_steps_with_idle_events_stay_large(test_fmu, here):
    steps = []
    for defines in ((), ("ALWAYS",)):
        problem = Problem(test_fmu("Stepping", defines=defines), (Experiment(TIME, ("x",)),), ((),), settings=TIGHT)
        steps.append(ran(problem, here).steps[0, 0])
    assert steps[1] <= 3 * steps[0]  # every event counts as a step of its own


def test_a_declared_pattern_that_leaves_out_a_dependency_is_not_used(test_fmu, here):
    model = test_fmu("VanDerPol")
    wrong = dataclasses.replace(model, jacobian_pattern=((1,), (0,)))  # x1' depends on x1 too
    found = [run(m, ("x0", "x1"), (ParameterTarget("mu"),), (3.0,), pool=here) for m in (model, wrong)]
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])


def test_a_model_that_factors_nothing_agrees_with_fmpy(test_fmu, here, drive):
    time = np.linspace(0.0, 4.0, 101)
    (signal,) = drive(time)
    signal = dataclasses.replace(signal, values=8.0 * signal.values)  # V; a few of them hardly lift the body
    experiment = Experiment(time, ("i", "w", "theta"), (signal,))
    model = test_fmu("Wide")
    assert model.jacobian_pattern is not None
    problem = Problem(model, (experiment,), ((ParameterTarget("R"),),), settings=SolverSettings(1e-8, 1e-8))
    with open_simulator(problem, pool=here) as native, FmpySimulator(problem) as reference:
        a, b = (s.simulate(np.array([[9.0]]), active=[0]) for s in (native, reference))
    assert np.all(np.abs(a.outputs[0] - b.outputs[0]).max(axis=1) < 1e-5 * np.ptp(b.outputs[0], axis=1))
    assert a.sensitivities is not None
    assert b.sensitivities is not None
    slope, other = a.sensitivities[0][0, :, :, 0], b.sensitivities[0][0, :, :, 0]
    assert np.all(np.abs(slope - other).max(axis=0) < 1e-3 * np.abs(other).max(axis=0))
