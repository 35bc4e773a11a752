"""Inputs that move at each sample: runs of the native engine beside closed forms and SciPy's solvers at 1e-10."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
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
from aero_bayes.simulation.model import Model
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


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@BOTH
def test_no_further_from_the_reference_than_a_millionth_of_the_range(
    exported, here, interpolation, text, slope, method, interval, size, trust
):
    rng = np.random.default_rng(2)
    time = interval * np.arange(81)
    level = size * (np.sin(time / (20.0 * interval)) + 0.2 * rng.standard_normal(time.size))
    model = exported(text)
    signal = InputSignal("u", time, level, interpolation)
    problem = Problem(model, (Experiment(time, (model.outputs[0].name,), (signal,)),), ((),))
    found = ran(problem, here)
    assert found.outcomes[0, 0] == Outcome.OK
    exact = reference(slope, time, level, interpolation, method, interval if method == "LSODA" else interval / 20.0)
    trust("scipy", np.abs(found.outputs[0][0, :, 0] - exact).max() / np.ptp(exact))
    assert np.abs(found.outputs[0][0, :, 0] - exact).max() <= 1e-6 * np.ptp(exact)


@pytest.mark.parametrize("directional", [True, False])
@pytest.mark.parametrize("delay", [0.0, 0.0037])
def test_a_linear_model_is_exact_at_uneven_samples_and_with_a_delay(test_fmu, here, directional, delay):
    rng = np.random.default_rng(5)
    time = np.concatenate([[0.0], np.cumsum(rng.choice([0.009, 0.01, 0.011], 300))])
    level = rng.standard_normal(time.size)
    experiment = Experiment(time, ("x",), (InputSignal("u", time, level),))
    targets, (k, b) = (ParameterTarget("k"), ParameterTarget("b"), DelayTarget()), (30.0, 0.7)
    problem = Problem(test_fmu("Dahlquist", directional=directional), (experiment,), (targets,), {"c": 0.0})
    found = ran(problem, here, [k, b, delay]).outputs[0][0, :, 0]
    exact, x = [found[0]], found[0]
    for j in range(1, time.size):
        for span, u in ((delay, level[max(j - 2, 0)]), (time[j] - time[j - 1] - delay, level[j - 1])):
            decay = float(expm(np.array([[-k * span]]))[0, 0])
            x = decay * x + b * u / k * (1.0 - decay)
        exact.append(x)
    np.testing.assert_allclose(found, exact, atol=2e-9 if delay == 0.0 else 2e-8)


def test_a_tighter_tolerance_is_kept_too(exported, here):
    time = 0.02 * np.arange(101)
    level = 6.0 * np.sin(time) + np.random.default_rng(3).standard_normal(time.size)
    experiment = Experiment(time, ("w",), (InputSignal("u", time, level),))
    problem = Problem(exported(MOTOR), (experiment,), ((),), settings=SolverSettings(1e-9, 1e-9))
    found = ran(problem, here).outputs[0][0, :, 0]
    exact = reference(motor, time, level, "hold", "LSODA", 0.02)
    assert np.abs(found - exact).max() <= 2e-8 * np.ptp(exact)


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


class Slave:
    """A co-simulation instance of a model with the input u, driven from sample to sample."""

    def __init__(self, model: Model, folder: Path) -> None:
        description = read_model_description(str(model.path))
        references = {v.name: v.valueReference for v in description.modelVariables}
        self.input, self.output = references["u"], references[model.outputs[0].name]
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=extract(str(model.path), str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="slave",
        )
        self.fmu.instantiate()

    def begin(self) -> None:
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def run(self, time: np.ndarray, level: np.ndarray) -> np.ndarray:
        """The output at the end of each step between two samples, over which the input is held."""
        found = []
        for k in range(time.size - 1):
            self.fmu.setReal([self.input], [level[k]])
            self.fmu.doStep(time[k], time[k + 1] - time[k])
            found += self.fmu.getReal([self.output])
        return np.array(found)


@BOTH
def test_exported_co_simulation_is_accurate_and_restarts_from_a_state(
    exported, tmp_path, text, slope, method, interval, size
):
    rng = np.random.default_rng(2)
    time = interval * np.arange(81)
    level = size * (np.sin(time / (20.0 * interval)) + 0.2 * rng.standard_normal(time.size))
    slave = Slave(exported(text), tmp_path / "unpacked")
    slave.begin()
    early = slave.run(time[:41], level[:41])
    state = slave.fmu.getFMUState()
    late = slave.run(time[40:], level[40:])
    exact = reference(slope, time, level, "hold", method, interval if method == "LSODA" else interval / 20.0)
    assert np.abs([*early, *late] - exact[1:]).max() <= 1e-6 * np.ptp(exact)
    slave.fmu.setFMUState(state)
    np.testing.assert_array_equal(slave.run(time[40:], level[40:]), late)
    slave.fmu.reset()
    slave.begin()
    np.testing.assert_array_equal(slave.run(time[:41], level[:41]), early)
    slave.fmu.freeFMUState(state)
    slave.fmu.freeInstance()


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
