"""Inputs that move at each sample: runs of the native engine beside closed forms and SciPy's solvers at 1e-10."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from runs import ran
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    SolverSettings,
)
from aero_bayes.simulation.native_simulator import NativeSimulator

pytestmark = pytest.mark.fast

MOTOR = """model Motor "A stiff circuit drives a rotor against the air"
  parameter Real R = 8.4;
  parameter Real L = 1.16e-3;
  parameter Real k = 2.4e-8;
  parameter Real J = 1.0e-5;
  input Real u;
  output Real w(start = 0, fixed = true);
  Real i(start = 0, fixed = true);
equation
  L * der(i) = u - R * i - 0.042 * w;
  J * der(w) = 0.042 * i - k * w * abs(w);
end Motor;
"""
STOP = """model Stop "A cart that meets a second spring: an event at each contact"
  parameter Real k = 40;
  parameter Real c = 25;
  input Real u;
  output Real x(start = 0, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(x) = v;
  der(v) = u - c * x - 2 * v - (if x > 0.02 then k * (x - 0.02) else 0);
end Stop;
"""
Slope = Callable[[float, np.ndarray, float], list[float]]


def motor(_t: float, x: np.ndarray, u: float) -> list[float]:
    """The motor's equations by hand: speed, current."""
    w, i = x
    return [(0.042 * i - 2.4e-8 * w * abs(w)) / 1.0e-5, (u - 8.4 * i - 0.042 * w) / 1.16e-3]


def stop(_t: float, x: np.ndarray, u: float) -> list[float]:
    """The cart's equations by hand."""
    return [x[1], u - 25.0 * x[0] - 2.0 * x[1] - (40.0 * (x[0] - 0.02) if x[0] > 0.02 else 0.0)]


BOTH = pytest.mark.parametrize(
    ("text", "slope", "method", "interval", "size"),
    [
        pytest.param(MOTOR, motor, "LSODA", 0.02, 6.0, id="stiff"),
        pytest.param(STOP, stop, "DOP853", 0.01, 1.0, id="events"),
    ],
)


def reference(
    slope: Slope, time: np.ndarray, level: np.ndarray, interpolation: str, method: str, step: float
) -> np.ndarray:
    """The first state at the samples, solved from sample to sample."""
    x, out = np.zeros(2), [0.0]
    for k in range(time.size - 1):
        ramp = (level[k + 1] - level[k]) / (time[k + 1] - time[k]) if interpolation == "linear" else 0.0

        def f(t: float, x: np.ndarray, start=time[k], base=level[k], ramp=ramp) -> list[float]:
            return slope(t, x, base + ramp * (t - start))

        x = solve_ivp(f, (time[k], time[k + 1]), x, method, rtol=1e-10, atol=1e-13, max_step=step).y[:, -1]
        out.append(x[0])
    return np.array(out)


@pytest.mark.parametrize(
    ("interpolation", "tolerance", "near"), [("hold", 1e-6, 1e-6), ("linear", 1e-6, 1e-6), ("hold", 1e-9, 2e-8)]
)
@BOTH
def test_no_further_from_the_reference_than_a_millionth_of_the_range(
    exported, here, interpolation, tolerance, near, text, slope, method, interval, size, trust
):
    rng = np.random.default_rng(2)
    time = interval * np.arange(81)
    level = size * (np.sin(time / (20.0 * interval)) + 0.2 * rng.standard_normal(time.size))
    model = exported(text)
    experiment = Experiment(time, (model.outputs[0].name,), (InputSignal("u", time, level, interpolation),))
    problem = Problem(model, (experiment,), ((),), {}, SolverSettings(tolerance, tolerance))
    found = ran(problem, here)
    assert found.outcomes[0, 0] == Outcome.OK
    exact = reference(slope, time, level, interpolation, method, interval if method == "LSODA" else interval / 20.0)
    error = np.abs(found.outputs[0][0, :, 0] - exact).max() / np.ptp(exact)
    trust("scipy", error)
    assert error <= near


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize(
    ("text", "parameters", "interval", "size"),
    [
        pytest.param(MOTOR, ("R", "k", "L", "J"), 0.02, 6.0, id="stiff"),
        pytest.param(STOP, ("k", "c"), 0.01, 1.0, id="events"),
    ],
)
def test_sensitivities_meet_the_differences_of_tight_runs(
    exported, here, interpolation, text, parameters, interval, size
):
    time = interval * np.arange(121)
    level = size * (np.sin(time / (20.0 * interval)) + 0.2 * np.random.default_rng(2).standard_normal(time.size))
    model = exported(text)
    experiment = Experiment(time, (model.outputs[0].name,), (InputSignal("u", time, level, interpolation),))
    targets = (*(ParameterTarget(p) for p in parameters), DelayTarget())
    values = np.array([*(float(model.parameter(p).start) for p in parameters), 0.3 * interval])
    problem = Problem(model, (experiment,), (targets,))
    tight = replace(problem, settings=SolverSettings(1e-11, 1e-11, max_steps=1_000_000))
    step = np.diag(1e-4 * values)
    with NativeSimulator(problem, pool=here) as simulator, NativeSimulator(tight, pool=here) as fine:
        found = simulator.simulate(values[None, :], active=range(values.size)).sensitivities[0][0, :, 0]
        high, low = (fine.simulate(values + sign * step).outputs[0][:, :, 0] for sign in (1.0, -1.0))
    exact = ((high - low) / (2.0 * np.diag(step)[:, None])).T
    assert np.all(np.abs(found - exact).max(axis=0) <= 1e-3 * np.ptp(exact, axis=0))


LINEAR = """model Linear "A stiff circuit drives a body on a spring"
  parameter Real R = 8;
  parameter Real c = 30;
  input Real u;
  output Real x(start = 0.1, fixed = true);
  Real v(start = 0, fixed = true);
  Real i(start = 0, fixed = true);
equation
  der(x) = v;
  der(v) = 4 * i - c * x - 0.5 * v;
  1e-3 * der(i) = u - R * i - 0.2 * v;
end Linear;
"""


def linear_reference(time: np.ndarray, level: np.ndarray, r: float, c: float) -> np.ndarray:
    """The body's position by the exponential of the matrix of states, input and its slope; the input is linear."""
    a = np.zeros((5, 5))
    a[0, 1], a[1, :3], a[2, 1:4], a[3, 4] = 1.0, (-c, -0.5, 4.0), (-200.0, -1e3 * r, 1e3), 1.0
    state, out = np.array([0.1, 0.0, 0.0]), [0.1]
    for k, h in enumerate(np.diff(time)):
        state = (expm(h * a) @ [*state, level[k], (level[k + 1] - level[k]) / h])[:3]
        out.append(state[0])
    return np.array(out)


@pytest.mark.parametrize("moves", [True, False])
def test_a_linear_model_is_exact_at_any_tolerance_where_inputs_move_and_where_they_rest(exported, here, moves):
    time = 0.02 * np.arange(120)
    at = np.arange(120) if moves else np.array([0, 40, 41, 119])
    level = 3.0 * np.random.default_rng(4).standard_normal(at.size)
    level[-1] = level[-1] if moves else level[-2]
    signal = InputSignal("u", time[at], level, "linear")
    experiment, targets = Experiment(time, ("x",), (signal,)), (ParameterTarget("R"), ParameterTarget("c"))
    problem = Problem(exported(LINEAR), (experiment,), (targets,), settings=SolverSettings(1e-3, 1e-3))
    found = ran(problem, here, [8.0, 30.0], active=(0, 1))
    everywhere = np.interp(time, time[at], level)
    exact = linear_reference(time, everywhere, 8.0, 30.0)
    np.testing.assert_allclose(found.outputs[0][0, :, 0], exact, atol=1e-10 * np.ptp(exact))
    for k, (dr, dc) in enumerate(((1e-4, 0.0), (0.0, 1e-4))):
        high, low = (linear_reference(time, everywhere, 8.0 + s * dr, 30.0 + s * dc) for s in (1.0, -1.0))
        slope = (high - low) / 2e-4
        np.testing.assert_allclose(found.sensitivities[0][0, :, 0, k], slope, atol=1e-6 * np.ptp(slope))


@pytest.mark.parametrize("law", ["sign(x)", "x * abs(x)", "tanh(u)", "time * x", "max(x, u)"])
def test_a_linear_model_is_told_from_others(exported, law):
    """Other equations have no mark of linear ones, not even those whose slopes are constant between steps."""
    marks = [
        [b"ab_linear" in zipfile.ZipFile(exported(text).path).read(f"binaries/linux64/{name}.so")]
        for name, text in (("Linear", LINEAR), ("Linear", LINEAR.replace("0.5 * v", f"0.5 * noEvent({law})")))
    ]
    assert marks == [[True], [False]]


def test_a_corner_between_the_points_of_a_step_is_seen(exported, here):
    """The second sample's speed would dip below zero and come back, were there no friction that holds it at zero."""
    model = exported("""model Dip
  input Real u;
  output Real v(start = -1.5012706, fixed = true);
equation
  der(v) = u - tanh(v / 1e-5);
end Dip;
""")
    time = np.array([0.0, 1.0, 2.0])
    experiment = Experiment(time, ("v",), (InputSignal("u", time, np.array([3.3, 0.3, 2.3]), "linear"),))
    found = ran(Problem(model, (experiment,), ((),), settings=SolverSettings(1e-6, 1e-6)), here, [])
    # it rests until the input reaches the friction, 0.35 into the sample
    np.testing.assert_allclose(found.outputs[0][0, 1:, 0], [0.1125, 0.65**2], atol=1e-4)
