"""State and time events of the native engine."""

from __future__ import annotations

from time import thread_time

import numpy as np
import pytest
from runs import ran
from scipy.integrate import quad

from aero_bayes.simulation.interface import Experiment, Outcome, ParameterTarget, Problem, SolverSettings, StartTarget
from aero_bayes.simulation.native_simulator import NativeSimulator

pytestmark = pytest.mark.fast


def bounce(time: np.ndarray, height: float, e: float, g: float = 9.81) -> np.ndarray:
    """Closed form of the ball's height."""
    out = np.empty_like(time)
    for k, t in enumerate(time):
        begin, v = -np.sqrt(2.0 * height / g), np.sqrt(2.0 * height * g)  # as if thrown up from the ground before t = 0
        while t > begin + 2.0 * v / g and v > 1e-3:
            begin += 2.0 * v / g
            v *= e
        out[k] = max(0.0, v * (t - begin) - 0.5 * g * (t - begin) ** 2) if v > 1e-3 else 0.0
    return out


def test_bouncing_ball(test_fmu, here, trust):
    time = np.linspace(0.0, 3.0, 301)
    problem = Problem(
        test_fmu("BouncingBall"), (Experiment(time, ("h", "v")),), ((StartTarget("h"), ParameterTarget("e")),)
    )
    values = np.array([[1.0, 0.7], [0.5, 0.5]])
    found = ran(problem, here, values, active=[0, 1])
    assert np.all(found.outcomes == Outcome.OK)
    for row, (height, e) in enumerate(values):
        np.testing.assert_allclose(found.outputs[0][row, :, 0], bounce(time, height, e), atol=1e-7)
        trust("events", np.max(np.abs(found.outputs[0][row, :, 0] - bounce(time, height, e))) / height)
    smooth = slice(0, 150)  # away from the bounces' pile-up, and off the bounces themselves
    exact = np.stack(
        [
            (bounce(time, 1.0 + 1e-6, 0.7) - bounce(time, 1.0 - 1e-6, 0.7)) / 2e-6,
            (bounce(time, 1.0, 0.7 + 1e-6) - bounce(time, 1.0, 0.7 - 1e-6)) / 2e-6,
        ],
        axis=1,
    )
    assert found.sensitivities is not None
    error = np.abs(found.sensitivities[0][0, smooth, 0] - exact[smooth])
    assert np.quantile(error, 0.97) < 1e-3


def test_stair_with_time_events(test_fmu, here):
    time = np.linspace(0.0, 3.0, 61) + 1e-3
    problem = Problem(
        test_fmu("Stair"), (Experiment(time, ("counter", "x")),), ((ParameterTarget("kick"),),), {"period": 0.25}
    )
    found = ran(problem, here, [0.5], active=[0])
    assert found.outcomes[0, 0] == Outcome.OK

    def counter(t: float) -> float:
        return np.floor(t / 0.25) + 1.0

    np.testing.assert_array_equal(found.outputs[0][0, :, 0], counter(time))
    points = np.arange(0.25, 3.0, 0.25)
    area = [quad(counter, time[0], t, points=points[points < t], limit=200)[0] for t in time]
    np.testing.assert_allclose(found.outputs[0][0, :, 1], np.array(area) + 0.5 * (time >= 2.0), atol=1e-6)
    assert found.sensitivities is not None
    np.testing.assert_allclose(found.sensitivities[0][0, :, 1, 0], (time >= 2.0).astype(float), atol=1e-6)


@pytest.mark.parametrize("defines", [("NO_CALLBACK",), ("NO_CALLBACK", "FMI3"), ()])
def test_time_events_of_a_model_without_states(test_fmu, here, defines):
    time = np.linspace(0.053, 2.0, 14)  # in places fewer samples than events, in others more
    problem = Problem(
        test_fmu("Ticker", defines=defines), (Experiment(time, ("count", "y")),), ((ParameterTarget("period"),),)
    )
    found = ran(problem, here, [[0.3], [0.07]])
    assert np.all(found.outcomes == Outcome.OK)
    for out, period in zip(found.outputs[0], (0.3, 0.07), strict=True):
        count = np.floor(time / period)
        np.testing.assert_allclose(out, np.stack([count, count + time], axis=1), atol=1e-12)


def test_events_cost_no_accuracy(test_fmu, here):
    time = np.linspace(0.0, 1.5, 31)
    errors = []
    for tolerance in (1e-4, 1e-8):
        settings = SolverSettings(tolerance, tolerance)
        problem = Problem(test_fmu("BouncingBall"), (Experiment(time, ("h",)),), ((),), settings=settings)
        out = ran(problem, here).outputs[0][0, :, 0]
        errors.append(np.max(np.abs(out - bounce(time, 1.0, 0.7))))
    assert max(errors) < 1e-9  # parabolas are integrated exactly: only the event times could err


STOP = """model Stop "Pushed at constant speed against a stop"
  parameter Real c = 0.7;
  parameter Real k = 3;
  parameter Real d = 0 "Counterforce that sets in all at once";
  output Real x(start = 0, fixed = true);
equation
  der(x) = 1 - (if x > c then k * (x - c) + d else 0);
end Stop;
"""


@pytest.mark.parametrize(("d", "near"), [(0.0, 1e-7), (0.25, 1e-4)])
def test_sensitivities_beyond_a_switch(exported, here, d, near):
    """Where the slope is the same on both sides, and where it is not."""
    time, c, k = np.linspace(0.0, 2.0, 41), 0.71, 3.0
    problem = Problem(
        exported(STOP), (Experiment(time, ("x",)),), ((ParameterTarget("c"), ParameterTarget("k")),), {"d": d},
        settings=SolverSettings(1e-9, 1e-9),
    )  # fmt: skip
    found = ran(problem, here, [c, k], active=[0, 1])
    late, after = time > c, time - c
    decay = np.exp(-k * after)
    x = np.where(late, c + (1.0 - d) * (1.0 - decay) / k, time)
    by_c = np.where(late, 1.0 - (1.0 - d) * decay, 0.0)
    by_k = np.where(late, (1.0 - d) * (after * decay / k - (1.0 - decay) / k**2), 0.0)
    assert found.sensitivities is not None
    np.testing.assert_allclose(found.outputs[0][0, :, 0], x, atol=1e-7)
    np.testing.assert_allclose(found.sensitivities[0][0, :, 0], np.stack([by_c, by_k], axis=1), atol=near)


@pytest.mark.parametrize("defines", [(), ("SMOOTHLESS",)])
def test_an_fmu_that_chatters_at_rest_ends_with_an_outcome(test_fmu, here, defines):
    """Another tool's FMU that is driven back at each event, or whose equations jump, does not hold up a batch."""
    experiment = Experiment(np.linspace(0.0, 3.0, 31), ("s",))
    problem = Problem(test_fmu("Rub", defines=defines), (experiment,), ((ParameterTarget("F_c"),),))
    with NativeSimulator(problem, pool=here) as simulator:
        before = thread_time()
        found = simulator.simulate(np.array([[0.5], [0.05]]))
        spent = thread_time() - before
    assert found.outcomes.ravel().tolist() == [
        Outcome.SOLVER_FAILED,
        Outcome.OK,
    ]  # the second is still moving at the end
    assert spent < 2.0


THERMOSTAT = """model Thermostat
  parameter Real C = 3e4;
  parameter Real G = 2.2;
  parameter Real P = 130;
  output Real T(start = 278, fixed = true);
  output Boolean on(start = false, fixed = true);
equation
  on = T > 279 or pre(on) and T > 275;
  C * der(T) = G * (295 - T) - (if on then P else 0);
end Thermostat;
"""


def test_sensitivities_of_a_thermostat_show_ratios_only(exported, here):
    """A common change of all three moves nothing; no difference is taken over a switching, so that ``on`` has none."""
    values = np.array([3e4, 2.2, 130.0])
    targets = (ParameterTarget("C"), ParameterTarget("G"), ParameterTarget("P"))
    experiment = Experiment(np.arange(0.0, 20000.0, 20.0), ("T", "on"))
    problem = Problem(exported(THERMOSTAT), (experiment,), (targets,))
    found = ran(problem, here, values, active=[0, 1, 2])
    assert found.sensitivities is not None
    slopes = found.sensitivities[0][0] * values
    assert np.ptp(found.outputs[0][0, :, 1]) == pytest.approx(1.0)
    assert np.abs(slopes[:, 0]).max() > 10.0
    assert np.abs(slopes[:, 0].sum(axis=1)).max() < 0.01
    assert np.abs(slopes[:, 1]).max() < 1e-6
