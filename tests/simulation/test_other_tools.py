"""FMUs that do as other tools' do: what they leave unsaid costs no right answer."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from runs import one_run, ran
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from test_engine_events import bounce

from aero_bayes.errors import InputError
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


#: Model, outputs, targets, their values.
SAME: dict[str, tuple[tuple[str, ...], tuple[ProblemTarget, ...], list[float]]] = {
    "Dahlquist": (("x", "y"), (ParameterTarget("k"), ParameterTarget("g")), [1.3, 0.7]),
    "VanDerPol": (("x0", "x1"), (ParameterTarget("mu"), StartTarget("x1")), [2.0, 0.3]),
    "BouncingBall": (("h", "v"), (ParameterTarget("e"),), [0.6]),
    "Stair": (("counter", "x"), (ParameterTarget("kick"),), [0.4]),
    "Circuit": (("i0", "v2", "power"), (ParameterTarget("R"), ParameterTarget("C")), [8.0, 2e-3]),
    "Feedthrough": (("y",), (ParameterTarget("gain"),), [3.0]),
    "Stepping": (("x",), (ParameterTarget("b"),), [0.5]),
    "Copies": (("h", "clipped", "driven"), (ParameterTarget("w"), StartTarget("h")), [2.0, 0.7]),
    "Loop": (("z",), (ParameterTarget("a"),), [0.4]),
}
CHANGES = [(name, ("FMI3",)) for name in SAME]
CHANGES += [("Copies", (define,)) for define in ("FIXED", "NOISY", "ONCE", "NO_RESET")]
CHANGES += [(name, ("HELD_INPUTS",)) for name in ("Copies", "Circuit", "Feedthrough")]
CHANGES += [("VanDerPol", ("IDLE_RESET",)), ("VanDerPol", ("FMI3", "IDLE_RESET"))]
CHANGES += [("Dahlquist", ("KEPT_START",)), ("Dahlquist", ("FMI3", "KEPT_START"))]


@pytest.mark.parametrize(("name", "defines"), CHANGES)
@pytest.mark.parametrize("directional", [True, False])
def test_ways_of_other_tools_change_no_number(test_fmu, here, pool, drive, name, defines, directional):
    outputs, targets, values = SAME[name]
    rows, found = np.outer([1.0, 1.1, 1.0], values), []
    for given, place in (((), here), (defines, pool)):
        model = test_fmu(name, directional=directional, defines=given)
        assert model.fmi_version == (3 if "FMI3" in given else 2)
        inputs = drive(TIME) if model.inputs else ()
        if "HELD_INPUTS" in defines:  # what is set at events only does not move linearly
            inputs = tuple(dataclasses.replace(signal, interpolation="hold") for signal in inputs)
        problem = Problem(model, (Experiment(TIME, outputs, inputs),), (targets,), settings=TIGHT)
        found.append(ran(problem, place, rows, range(len(values))))
    plain, other = found
    assert np.all(other.outcomes == Outcome.OK)
    np.testing.assert_array_equal(other.outputs[0], plain.outputs[0])
    np.testing.assert_array_equal(other.sensitivities[0], plain.sensitivities[0])


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


def test_directional_derivatives_that_leave_parameters_out_are_not_used(test_fmu, here):
    targets, values = (ParameterTarget("mu"), StartTarget("x1")), (2.0, 0.3)
    full, part = (
        run(test_fmu("VanDerPol", defines=defines), ("x0", "x1"), targets, values, pool=here)[1]
        for defines in ((), ("ONLY_STATES",))
    )
    np.testing.assert_allclose(part, full, atol=1e-6 * np.abs(full).max())
