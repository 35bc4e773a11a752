"""Trajectories and sensitivities of the native engine against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from runs import one_run, ran
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool

pytestmark = pytest.mark.fast

TIGHT = SolverSettings(1e-9, 1e-9)
VARIANTS = [
    pytest.param({"directional": True}, id="exact derivatives"),
    pytest.param({"directional": True, "defines": ("REFUSE",)}, id="no derivatives for parameters"),
    pytest.param({"directional": False}, id="no derivatives"),
]


def run(
    pool: WorkerPool,
    model: Model,
    experiment: Experiment,
    targets: tuple[ProblemTarget | None, ...] = (),
    values: tuple[float, ...] = (),
    settings: SolverSettings = TIGHT,
    fixed: dict[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    problem = Problem(model, (experiment,), (targets,), fixed or {}, settings)
    return one_run(problem, pool, values)


def response(time: np.ndarray, signal: InputSignal, k: float, b: float, x0: float, delay: float = 0.0) -> np.ndarray:
    """x' = -k x + b u from x0: the input is a sum of steps, or of ramps, and so is what it adds to x."""
    x, t = x0 * np.exp(-k * time), np.maximum(time[:, None] - np.append(-np.inf, signal.time[1:] + delay), 0.0)
    x += b / k * signal.values[0] * (1.0 - np.exp(-k * time))
    if signal.interpolation == "hold":
        return x + (b / k * (1.0 - np.exp(-k * t[:, 1:]))) @ np.diff(signal.values)
    rate = np.diff(signal.values) / np.diff(signal.time)
    t = np.maximum(time[:, None] - signal.time - delay, 0.0)
    return x + (b / k * (t - (1.0 - np.exp(-k * t)) / k)) @ np.diff(rate, prepend=0.0, append=0.0)


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-5])
def test_a_state_without_a_nominal_value_is_as_exact_however_small(test_fmu, here, drive, size):
    time = np.linspace(0.0, 4.0, 41)
    signal = replace(drive(time)[0], values=size * drive(time)[0].values)
    experiment = Experiment(time, ("x",), (signal,))
    targets, (k, b) = (ParameterTarget("k"), ParameterTarget("b"), StartTarget("x")), (1.3, 0.7)
    x = ran(Problem(test_fmu("Dahlquist"), (experiment,), (targets,)), here, [k, b, size]).outputs[0][0, :, 0]
    np.testing.assert_allclose(x / size, response(time, signal, k, b, size) / size, atol=1e-5)


@pytest.mark.parametrize("variant", VARIANTS)
def test_decay_with_a_driven_input(test_fmu, here, drive, variant, trust):
    time = np.linspace(0.0, 4.0, 81)
    (signal,) = drive(time)
    experiment = Experiment(time, ("x", "y"), (signal,))
    targets = (ParameterTarget("k"), ParameterTarget("b"), ParameterTarget("c"), StartTarget("x"), DelayTarget(), None)
    given = np.array([1.3, 0.7, 0.2, 1.5, 0.013])
    out, slopes = run(here, test_fmu("Dahlquist", **variant), experiment, targets, (*given, 9.0))

    def exact(values: np.ndarray) -> np.ndarray:
        k, b, c, x0, delay = values
        x = response(time, signal, k, b, x0, delay)
        late = time - delay
        u = np.interp(late, signal.time, signal.values)
        if signal.interpolation == "hold":
            u = signal.values[np.clip(np.searchsorted(signal.time, late, side="right") - 1, 0, None)]
        return np.stack([x, 2.0 * x + 3.0 * u + c], axis=1)

    trust("closed-form", np.max(np.abs(out - exact(given)) / np.ptp(exact(given), axis=0)))
    np.testing.assert_allclose(out, exact(given), atol=4e-8)
    step = 1e-6 * np.eye(5)
    expected = np.stack([(exact(given + h) - exact(given - h)) / 2e-6 for h in step], axis=2)
    np.testing.assert_allclose(slopes[..., :5], expected, atol=4e-6)
    np.testing.assert_array_equal(slopes[..., 5], 0.0)


def test_values_that_are_known_in_each_run(test_fmu, here):
    """Each run has its own k and starts anew, whichever ran before; what is searched or fixed for all stays so."""
    time = np.linspace(0.0, 4.0, 41)
    signal = InputSignal("u", np.array([0.0, 1.0]), np.array([1.0, 3.0]))
    rates, targets = (0.4, 1.3, 0.9), (ParameterTarget("b"), StartTarget("x"))
    runs = tuple(Experiment(time, ("x",), (signal,), known={"k": k}) for k in rates)
    problem = Problem(test_fmu("Dahlquist"), runs, (targets,) * 3, {"k": 7.0, "c": 0.0}, SolverSettings(1e-9, 1e-9))
    found = ran(problem, here, [[0.7, 1.5], [0.2, 0.5]], active=[0])
    for e, k in enumerate(rates):
        for row, (b, x) in enumerate(((0.7, 1.5), (0.2, 0.5))):
            np.testing.assert_allclose(found.outputs[e][row, :, 0], response(time, signal, k, b, x), atol=1e-6)
            slope = response(time, signal, k, b + 0.5, x) - response(time, signal, k, b - 0.5, x)
            np.testing.assert_allclose(found.sensitivities[e][row, :, 0, 0], slope, atol=1e-5)


@pytest.mark.parametrize("variant", VARIANTS)
def test_explicit_time_dependence(test_fmu, here, variant, trust):
    # x' = -k x + a cos(w t), the particular solution rotates with w
    time = np.linspace(0.0, 10.0, 101)
    k, a, w = 2.0, 1.5, 3.0
    targets = (ParameterTarget("a"), ParameterTarget("w"))
    model = test_fmu("Dahlquist", **variant)

    def exact(a: float, w: float) -> np.ndarray:
        particular = a * (k * np.cos(w * time) + w * np.sin(w * time)) / (k**2 + w**2)
        return particular + (1.0 - a * k / (k**2 + w**2)) * np.exp(-k * time)

    out, slopes = run(here, model, Experiment(time, ("x",)), targets, (a, w), fixed={"k": k})
    trust("closed-form", np.max(np.abs(out[:, 0] - exact(a, w))) / np.ptp(exact(a, w)))
    np.testing.assert_allclose(out[:, 0], exact(a, w), atol=3e-8)
    np.testing.assert_allclose(slopes[:, 0, 0], (exact(a + 1e-5, w) - exact(a - 1e-5, w)) / 2e-5, atol=1e-6)
    np.testing.assert_allclose(slopes[:, 0, 1], (exact(a, w + 1e-5) - exact(a, w - 1e-5)) / 2e-5, atol=3e-6)


@pytest.mark.parametrize("directional", [True, False])
def test_start_that_depends_on_a_parameter(test_fmu, here, directional):
    time = np.linspace(0.0, 2.0, 21)
    model = test_fmu("Dahlquist", directional=directional)
    out, slopes = run(here, model, Experiment(time, ("x",)), (ParameterTarget("g"), ParameterTarget("k")), (3.0, 1.0))
    np.testing.assert_allclose(out[:, 0], 3.0 * np.exp(-time), atol=1e-8)
    np.testing.assert_allclose(slopes[:, 0, 0], np.exp(-time), atol=1e-6)
    np.testing.assert_allclose(slopes[:, 0, 1], -3.0 * time * np.exp(-time), atol=1e-6)


@pytest.mark.parametrize("moves", [False, True], ids=["one level", "held samples"])
@pytest.mark.parametrize("directional", [True, False])
def test_stiff_circuit(test_fmu, here, directional, moves):
    model = test_fmu("Circuit", directional=directional)
    r, inductance, c, g = 10.0, 1e-4, 1e-3, 1e-3

    def system(r: float) -> tuple[np.ndarray, np.ndarray]:
        a, b = np.zeros((6, 6)), np.zeros(6)
        b[0] = 1.0 / inductance
        for k in range(3):
            i, v = 2 * k, 2 * k + 1
            a[i, i], a[i, v], a[v, i], a[v, v] = -r / inductance, -1.0 / inductance, 1.0 / c, -g / c
            if k:
                a[i, v - 2] = 1.0 / inductance
            if k < 2:
                a[v, i + 2] = -1.0 / c
        return a, b

    def exact(r: float, time: np.ndarray) -> np.ndarray:
        a, b = system(r)
        unit, x, found = -np.linalg.solve(a, b), np.zeros(6), []
        for span, level in zip(np.diff(time, prepend=0.0), (u[0], *u[:-1]), strict=True):
            x = level * unit + expm(a * span) @ (x - level * unit)
            found.append(x)
        return np.stack(found)

    time = np.concatenate([np.linspace(0.0, 1e-4, 6), np.linspace(2e-4, 0.5, 15)])
    u = 5.0 + moves * np.random.default_rng(1).standard_normal(time.size)
    signal = InputSignal("u", time, u) if moves else InputSignal("u", time[:1], u[:1])
    out, slopes = run(here, model, Experiment(time, ("i0", "v2", "power"), (signal,)), (ParameterTarget("R"),), (r,))
    x = exact(r, time)
    np.testing.assert_allclose(out[:, 0], x[:, 0], atol=3e-8)
    np.testing.assert_allclose(out[:, 1], x[:, 5], atol=1e-7)
    np.testing.assert_allclose(out[:, 2], u * x[:, 0], atol=2e-7)
    dx = (exact(r + 1e-4, time) - exact(r - 1e-4, time)) / 2e-4
    np.testing.assert_allclose(slopes[:, 0, 0], dx[:, 0], atol=2e-6)
    np.testing.assert_allclose(slopes[:, 1, 0], dx[:, 5], atol=2e-6)
    np.testing.assert_allclose(slopes[:, 2, 0], u * dx[:, 0], atol=1e-5)


def test_error_follows_the_tolerance(test_fmu, here):
    experiment = Experiment(np.linspace(0.0, 20.0, 401), ("x0", "x1"))
    exact = solve_ivp(
        lambda t, x: [x[1], 5.0 * (1.0 - x[0] ** 2) * x[1] - x[0]], (0.0, 20.0), [2.0, 0.0], "DOP853", experiment.time,
        rtol=1e-13, atol=1e-13,
    ).y.T  # fmt: skip
    errors = []
    for tolerance in (1e-4, 1e-6, 1e-8):
        settings = SolverSettings(tolerance, tolerance)
        out, _ = run(here, test_fmu("VanDerPol"), experiment, (ParameterTarget("mu"),), (5.0,), settings)
        errors.append(np.max(np.abs(out - exact)))
    # the fast flanks turn an error of the phase into a large one of x1
    assert errors[0] < 2e-1
    assert errors[1] < 2e-3
    assert errors[2] < 2e-5
    assert errors[0] > 4.0 * errors[1] > 16.0 * errors[2]


def test_no_states_and_a_resource(test_fmu, here, drive):
    time = np.linspace(0.0, 1.0, 11)
    (signal,) = drive(time)
    experiment = Experiment(time, ("y", "resource"), (signal,))
    targets = (ParameterTarget("gain"), ParameterTarget("offset"))
    out, slopes = run(here, test_fmu("Feedthrough"), experiment, targets, (2.0, 0.5))
    u = signal.values if signal.time.size == time.size else np.where(time >= 0.7, 3.0, 1.0)
    np.testing.assert_allclose(out, np.stack([2.0 * u + 0.5, np.full(11, 42.5)], axis=1))
    np.testing.assert_allclose(slopes[:, 0], np.stack([u, np.ones(11)], axis=1))
    np.testing.assert_allclose(slopes[:, 1], 0.0)


def test_sample_at_a_jump_takes_the_value_after_it(test_fmu, here):
    signal = InputSignal("u", np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0, 2.0]))
    experiment = Experiment(np.array([0.0, 0.5, 1.0]), ("y",), (signal,), start={"x": 0.0})
    out, _ = run(here, test_fmu("Dahlquist"), experiment, fixed={"b": 0.0})
    np.testing.assert_allclose(out[:, 0], [0.0, 3.0, 6.0], atol=1e-12)


def test_single_sample(test_fmu, here):
    out, _ = run(here, test_fmu("Dahlquist"), Experiment(np.array([3.0]), ("x", "y"), start={"x": 2.0}))
    np.testing.assert_allclose(out, [[2.0, 4.0]])


def test_refused_derivatives_are_noticed_whatever_is_asked_first(test_fmu, here):
    time = np.linspace(0.0, 2.0, 21)
    targets = (StartTarget("x"), ParameterTarget("k"))
    problem = Problem(test_fmu("Dahlquist", defines=("REFUSE",)), (Experiment(time, ("x",)),), (targets,), {}, TIGHT)
    with NativeSimulator(problem, pool=here) as simulator:
        for active in ([0], [1], [0, 1]):
            found = simulator.simulate(np.array([[2.0, 1.0]]), active=active)
            exact = np.stack([np.exp(-time), -2.0 * time * np.exp(-time)], axis=1)[:, active]
            assert found.sensitivities is not None
            np.testing.assert_allclose(found.sensitivities[0][0, :, 0], exact, atol=1e-6)


@pytest.mark.parametrize("tolerance", [1e-5, 1e-8])
def test_outputs_between_the_points_of_a_long_step(test_fmu, here, tolerance):
    # x = cos(w t), v = -w sin(w t), w^2 = k; a step spans hundreds of samples, the outputs are no states
    time = np.linspace(0.0, 12.0, 40_001)
    outputs = ("linear", "smooth", "kink", "bump")
    targets = (ParameterTarget("k"), ParameterTarget("d"), ParameterTarget("width"))
    k, d, width = 1.7, 0.31, 0.03
    settings = SolverSettings(tolerance, tolerance)
    out, slopes = run(here, test_fmu("Swing"), Experiment(time, outputs), targets, (k, d, width), settings)
    w = np.sqrt(k)
    x, v = np.cos(w * time), -w * np.sin(w * time)
    dx, dv = -time * np.sin(w * time) / (2.0 * w), -np.sin(w * time) / (2.0 * w) - 0.5 * time * np.cos(w * time)
    away, above = (x - d) / width, x > d
    bump = 1.0 / (1.0 + away**2)
    exact = np.stack([3.0 * x + v + d, np.exp(x * v), np.where(above, x - d, 0.0), bump], axis=1)
    np.testing.assert_allclose(out[:, :3], exact[:, :3], atol=300.0 * tolerance)
    # the bump turns an error of x into one of itself that is 1 / width times as large
    np.testing.assert_allclose(out[:, 3], bump, atol=1000.0 * tolerance)
    fall = -2.0 * away * bump**2 / width
    none = np.zeros_like(time)
    by_k = [3.0 * dx + dv, exact[:, 1] * (dx * v + x * dv), np.where(above, dx, 0.0), fall * dx]
    by_d = [none + 1.0, none, np.where(above, -1.0, 0.0), -fall]
    by_width = [none, none, none, -fall * away]
    expected = np.stack([np.stack(column, axis=1) for column in (by_k, by_d, by_width)], axis=2)
    # within a sample of the kink its slope may be that of either side
    sure = np.abs(x - d) > max(100.0 * tolerance, 5e-4)
    scale = np.abs(expected).max(axis=0)
    scale[scale == 0.0] = 1.0
    assert (np.abs(slopes - expected) / scale)[sure].max() < 3e4 * tolerance


CHAIN = """model Chain "Two lags, one far faster than the other"
  parameter Real T_1 = 0.5;
  parameter Real T_2 = 0.003;
  input Real u;
  Real x(start = 0, fixed = true);
  output Real y(start = 0, fixed = true);
equation
  T_1 * der(x) = u - x;
  T_2 * der(y) = x - y;
end Chain;
"""


def test_sensitivities_that_die_away_take_no_more_steps_than_the_states(exported, here):
    """Where the input rests all that is left of them is rounding, which no step is short enough for."""
    time, jumps = np.linspace(0.0, 1000.0, 8001), np.arange(0.0, 1000.0, 100.0)
    levels = np.random.default_rng(1).uniform(0.1, 0.3, jumps.size)
    experiment = Experiment(time, ("y",), (InputSignal("u", jumps, levels),))
    few, one, two = SolverSettings(1e-5, 1e-5, max_steps=1000), 0.5, 0.003
    targets = (ParameterTarget("T_1"), ParameterTarget("T_2"))
    found = ran(Problem(exported(CHAIN), (experiment,), (targets,), {}, few), here, [one, two], active=[0, 1])
    assert found.outcomes[0, 0] == Outcome.OK
    assert found.sensitivities is not None

    def exact(one: float, two: float) -> np.ndarray:
        after = np.maximum(time[:, None] - jumps, 0.0)
        rest = (one * np.exp(-after / one) - two * np.exp(-after / two)) / (one - two)
        return (1.0 - rest) @ np.diff(levels, prepend=0.0)

    slopes = [
        (exact(one + 1e-6, two) - exact(one - 1e-6, two)) / 2e-6,
        (exact(one, two + 1e-8) - exact(one, two - 1e-8)) / 2e-8,
    ]
    for column, slope in enumerate(slopes):
        np.testing.assert_allclose(found.sensitivities[0][0, :, 0, column], slope, atol=1e-3 * np.abs(slope).max())


def test_a_run_beyond_its_step_budget_is_too_slow(test_fmu, here) -> None:
    model = test_fmu("Dahlquist")
    time = np.linspace(0.0, 5.0, 11)
    found = {}
    for most in (0, 2):
        experiment = Experiment(time, ("y",), most_steps=most)
        found[most] = ran(Problem(model, (experiment,), ((),)), here)
    assert found[0].outcomes[0, 0] == Outcome.OK
    assert found[0].steps[0, 0] > 2
    assert found[2].outcomes[0, 0] == Outcome.TOO_SLOW
