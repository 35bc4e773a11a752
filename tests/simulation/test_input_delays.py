"""Delays of single inputs, of any length, against closed forms of a first-order lag with two inputs."""

from __future__ import annotations

import numpy as np
import pytest
from runs import one_run

from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    ParameterTarget,
    Problem,
    ProblemTarget,
    SolverSettings,
)
from aero_bayes.simulation.model import Model

pytestmark = pytest.mark.fast

SOURCE = """model Two "A lag with two inputs, one of which is also read"
  parameter Real k(unit = "1/s") = 0.5;
  input Real u(unit = "1/s");
  input Real w(unit = "1/s");
  output Real x(start = 0, fixed = true);
  output Real y;
equation
  der(x) = -k * x + u + 3 * w;
  y = x + w;
end Two;
"""
K, TIME = 0.5, np.linspace(0.0, 20.0, 201)
TIGHT = SolverSettings(1e-10, 1e-10)


@pytest.fixture(scope="module")
def model(exported) -> Model:
    return exported(SOURCE)


def step(at: float) -> np.ndarray:
    """Answer of x to an input that goes from 0 to 1."""
    since = np.maximum(TIME - at, 0.0)
    return (1.0 - np.exp(-K * since)) / K


def ramp(at: float) -> np.ndarray:
    """Answer of x to an input that rises by 1/s from some time on."""
    since = np.maximum(TIME - at, 0.0)
    return since / K - (1.0 - np.exp(-K * since)) / K**2


def simulated(
    model: Model,
    signals: tuple[InputSignal, ...],
    targets: tuple[ProblemTarget, ...],
    values: tuple[float, ...],
) -> tuple[np.ndarray, np.ndarray]:
    problem = Problem(model, (Experiment(TIME, ("x", "y"), signals),), (targets,), {}, TIGHT)
    return one_run(problem, None, values)


@pytest.mark.parametrize(
    ("late_u", "late_w"),
    [(0.0, 9.013), (12.345, 0.02), (3.017, 1.017)],
    ids=["w alone, for long", "u mostly", "both jump at once"],
)
def test_each_held_input_has_a_delay_of_its_own(model, late_u: float, late_w: float):
    on = {"u": 1.0, "w": 3.0}
    signals = tuple(InputSignal(name, np.array([0.0, at]), np.array([0.0, 1.0])) for name, at in on.items())
    targets = (DelayTarget("u"), DelayTarget("w"), DelayTarget())
    out, slopes = simulated(model, signals, targets, (late_u, late_w, 0.0))
    u, w = on["u"] + late_u, on["w"] + late_w
    x = step(u) + 3.0 * step(w)
    np.testing.assert_allclose(out[:, 0], x, atol=1e-7)
    np.testing.assert_allclose(out[:, 1], x + (w <= TIME), atol=1e-7)
    by_u, by_w = (-np.where(at < TIME, np.exp(-K * (TIME - at)), 0.0) for at in (u, w))
    expected = np.stack([by_u, 3.0 * by_w, by_u + 3.0 * by_w], axis=1)
    away = np.min(np.abs(TIME[:, None] - [[u, w]]), axis=1) > 1e-4
    np.testing.assert_allclose(slopes[away, 0], expected[away], atol=2e-5)


def test_an_input_that_jumps_at_the_first_sample_waits_alone(model):
    signals = (
        InputSignal("u", np.array([-1.0, 0.0]), np.array([0.0, 1.0])),
        InputSignal("w", np.array([-1.0, 0.0]), np.array([0.0, 2.0])),
    )
    _, slopes = simulated(model, signals, (DelayTarget("u"), DelayTarget("w")), (0.0, 0.0))
    np.testing.assert_allclose(slopes[:, 0], -np.exp(-K * TIME)[:, None] * [[1.0, 6.0]], atol=1e-6)


def test_straight_lines_and_steps_are_delayed_apart(model):
    signals = (
        InputSignal("u", np.array([0.0, 2.0, 4.0]), np.array([0.0, 2.0, 2.0]), "linear"),
        InputSignal("w", np.array([0.0, 1.0]), np.array([0.0, 1.0])),
    )
    out, slopes = simulated(model, signals, (DelayTarget("u"), DelayTarget("w")), (7.03, 0.51))
    np.testing.assert_allclose(out[:, 0], ramp(7.03) - ramp(9.03) + 3.0 * step(1.51), atol=1e-7)
    np.testing.assert_allclose(slopes[:, 0, 0], step(9.03) - step(7.03), atol=1e-6)


def test_a_delay_of_an_input_that_is_not_there_is_refused(model):
    with pytest.raises(InputError, match="input 'v'"):
        simulated(model, (), (DelayTarget("v"),), (0.1,))


@pytest.mark.parametrize("late", [0.0, 0.013])
def test_slopes_at_samples_between_two_values_of_a_held_input_are_differences(model, late: float):
    rng = np.random.default_rng(3)
    times = TIME[::2] if late == 0.0 else TIME
    signals = tuple(InputSignal(name, times, rng.uniform(-1.0, 1.0, times.size)) for name in ("u", "w"))
    targets = (ParameterTarget("k"), DelayTarget())
    _, slopes = simulated(model, signals, targets, (K, late))
    above, below = (simulated(model, signals, targets, (K + d, late))[0] for d in (1e-5, -1e-5))
    np.testing.assert_allclose(slopes[..., 0], (above - below) / 2e-5, atol=1e-7 * np.abs(slopes[..., 0]).max())
