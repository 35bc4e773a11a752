"""Dry friction held on a side by the engine, with rest as a state of its own: against a second implementation with
SciPy, differences, and the rounded law that is written into a model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_attach import family, here  # noqa: F401

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

TIME = np.linspace(0.0, 8.0, 161)
F_V, MASS = 0.4, 2.0
#: Friction at +1 and at -1 of its step, by speed and the rest of the balance.
LAWS: dict[str, tuple[dict[str, float], Callable[[float, float], tuple[float, float]]]] = {
    "coulomb_friction": ({"F_c": 0.6}, lambda v, load: (0.6, -0.6)),
    "friction_by_direction": ({"F_c": 0.6, "a": 0.4}, lambda v, load: (0.84, -0.36)),
    "stribeck_friction": (
        {"F_c": 0.5, "r": 0.8, "v_s": 0.1},
        lambda v, load: (f := 0.5 * (1.0 + 0.8 * np.exp(-((v / 0.1) ** 2))), -f),
    ),
    "load_friction": ({"L": 0.2, "f_0": 2.0}, lambda v, load: (f := 0.2 * (2.0 + abs(load)), -f)),
}
CART = """model Cart
  parameter Real M(unit = "kg") = 2;
  parameter Real F_v(unit = "N.s/m") = 0.4;
  parameter Real K(unit = "N/m") = 8;
  input Real F(unit = "N");
  output Real q(unit = "m") = x;
  output Real s(unit = "m/s") = v;
  Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  M * der(v) = F - F_v * v - K * SPRING;
end Cart;
"""
SPRINGS = {"linear": ("x", lambda x: 8.0 * x), "nonlinear": ("(x + 0.5 * x ^ 3)", lambda x: 8.0 * (x + 0.5 * x**3))}


def pull() -> np.ndarray:
    return 2.5 * np.sign(np.sin(1.3 * TIME + 0.2)) * (TIME > 1.0) + 1.2 * np.sin(2.1 * TIME) * (TIME > 0.5)


def model_of(modelica, tmp_path, law: str, spring: str = "linear"):
    found = family("Cart", tmp_path, modelica(CART.replace("SPRING", SPRINGS[spring][0])))
    id_ = f"{law}@v"
    names = found.placed[id_].names
    return found.with_candidates([id_]).model, {names[k]: x for k, x in LAWS[law][0].items()}


def run(model, given, pool, interpolation: str = "hold", slopes: bool = False, delay: float = 0.0, rtol: float = 1e-9):
    experiment = Experiment(TIME, ("q", "s"), (InputSignal("F", TIME, pull(), interpolation),))
    targets = (*map(ParameterTarget, given), DelayTarget("F"))
    problem = Problem(model, (experiment,), (targets,), settings=SolverSettings(rtol, rtol, 1_000_000, 60.0))
    with open_simulator(problem, pool=pool) as simulator:
        point = np.array([[*given.values(), delay]])
        found = simulator.simulate(point, active=range(len(targets)) if slopes else None)
    assert found.outcomes[0, 0] == Outcome.OK
    return (found.outputs[0][0], found.sensitivities[0][0]) if slopes else found.outputs[0][0]


def by_scipy(limits, interpolation: str, spring) -> np.ndarray:
    """Position and speed: steps between events at which the speed is zero, or at which what acts exceeds friction."""
    force, rows, y, side = pull(), [(0.0, 0.0)], np.zeros(2), 0
    for k in range(len(TIME) - 1):
        slope = (force[k + 1] - force[k]) / (TIME[k + 1] - TIME[k]) if interpolation == "linear" else 0.0
        t, end = TIME[k], TIME[k + 1]

        def acts(t, x, k=k, slope=slope):
            return force[k] + slope * (t - TIME[k]) - spring(x)

        def friction(t, y, side):
            return limits(y[1], acts(t, y[0]) - F_V * y[1])[0 if side > 0 else 1]

        def side_of(t, y):
            high, low = limits(0.0, acts(t, y[0]))
            return int(acts(t, y[0]) > high) - int(acts(t, y[0]) < low)

        if side == 0:
            side = side_of(t, y)
        while t < end:
            if side == 0:

                def leaves(t, x=y[0]):
                    high, low = limits(0.0, acts(t, x))
                    return min(high - acts(t, x), acts(t, x) - low)

                if leaves(end) < 0.0:
                    low, high = t, end
                    for _ in range(80):
                        middle = 0.5 * (low + high)
                        low, high = (low, middle) if leaves(middle) < 0.0 else (middle, high)
                    t, side = high, side_of(end, y)
                else:
                    t = end
                continue

            def rates(t, y, side=side):
                return [y[1], (acts(t, y[0]) - F_V * y[1] - friction(t, y, side)) / MASS]

            def stops(t, y, side=side):
                return side * y[1] + 1e-12

            stops.terminal, stops.direction = True, -1
            found = solve_ivp(rates, (t, end), y, method="DOP853", rtol=1e-11, atol=1e-13, events=stops, max_step=0.01)
            t, y = found.t[-1], found.y[:, -1].copy()
            if found.status == 1:
                y[1] = 0.0
                side = side_of(t, y)
        rows.append(tuple(y))
    return np.array(rows)


@pytest.mark.parametrize("spring", SPRINGS)
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("law", LAWS)
def test_friction_and_rest_are_those_of_a_second_implementation(law, interpolation, spring, here, modelica, tmp_path):  # noqa: F811
    model, given = model_of(modelica, tmp_path, law, spring)
    assert model.relay is not None
    assert model.relay.speed == ((model.state_index("s"), 1.0),)
    found, expected = run(model, given, here, interpolation), by_scipy(LAWS[law][1], interpolation, SPRINGS[spring][1])
    resting = np.abs(expected[:, 1]) < 1e-9
    assert 0.02 < resting[25:].mean() < 0.9  # it rests at times after the start
    np.testing.assert_allclose(found, expected, atol=2e-6 * np.ptp(expected, axis=0).max())


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("law", LAWS)
def test_sensitivities_over_turns_and_rest_are_differences(law, interpolation, here, modelica, tmp_path):  # noqa: F811
    model, given = model_of(modelica, tmp_path, law)
    given |= {"K": 8.0, "M": 2.0}
    _, slopes = run(model, given, here, interpolation, slopes=True, delay=0.01)
    for k, name in enumerate((*given, None)):
        value = 0.01 if name is None else given[name]
        h = 2e-5 * abs(value)
        up, down = (
            run(model, given if name is None else given | {name: value + s * h}, here, interpolation,
                delay=0.01 + s * h if name is None else 0.01, rtol=1e-11)
            for s in (1.0, -1.0)
        )  # fmt: skip
        difference = (up - down) / (2.0 * h)
        away = np.abs(slopes[:, :, k] - difference).max(axis=1) > 1e-3 * np.abs(difference).max()
        assert away.mean() < 0.02, name  # only where a turn moves over a sample between the two


def test_a_speed_at_the_start_is_lost_where_the_model_rests(here, modelica, tmp_path):  # noqa: F811
    """Its sensitivity is zero, and the state moves by the square of the speed."""
    model, given = model_of(modelica, tmp_path, "coulomb_friction")
    experiment = Experiment(TIME, ("q", "s"), (InputSignal("F", TIME, pull()),))
    targets = (StartTarget("s"), *map(ParameterTarget, given))
    problem = Problem(model, (experiment,), (targets,), settings=SolverSettings(1e-9, 1e-9, 1_000_000, 60.0))
    with open_simulator(problem, pool=here) as simulator:
        still = simulator.simulate(np.array([[0.0, *given.values()]]), active=range(len(targets)))
        moved = simulator.simulate(np.array([[1e-3, *given.values()]]))
    assert np.abs(still.sensitivities[0][0][:, :, 0]).max() < 1e-6
    way = MASS * 1e-3**2 / (2.0 * given["F_c"])  # on which the force of friction takes its energy
    assert moved.outputs[0][0][5, 0] - still.outputs[0][0][5, 0] == pytest.approx(way, rel=0.02)


@pytest.mark.parametrize("law", LAWS)
def test_the_rounded_law_is_close(law, here, modelica, tmp_path):  # noqa: F811
    model, given = model_of(modelica, tmp_path, law)
    held, rounded = run(model, given, here), run(replace(model, relay=None), given, here)
    assert 0.0 < np.abs(held - rounded).max() < 2e-3 * np.ptp(rounded)


def test_a_law_that_is_off_changes_nothing(here, modelica, tmp_path):  # noqa: F811
    model, given = model_of(modelica, tmp_path, "coulomb_friction")
    base = family("Cart", tmp_path / "base", modelica(CART.replace("SPRING", "x"))).base_model()
    off, plain = run(model, given | {k: 0.0 for k in given}, here), run(base, {}, here)
    np.testing.assert_allclose(off, plain, atol=1e-8)


TWO = """model Two
  input Real F(unit = "N");
  output Real q(unit = "m") = x - y;
  Real x(unit = "m", start = 0, fixed = true);
  Real y(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
  Real w(unit = "m/s", start = 0, fixed = true);
  Real f(unit = "N") = 3 * (x - y) + 0.1 * (v - w);
equation
  der(x) = v;
  der(y) = w;
  2 * der(v) = F - f;
  1 * der(w) = f;
end Two;
"""


def test_friction_between_two_bodies_is_held_by_their_relative_speed(here, modelica, tmp_path):  # noqa: F811
    found = family("Two", tmp_path, modelica(TWO))
    id_ = next(i for i, p in found.placed.items() if p.law.id == "coulomb_friction" and p.port.neighbours)
    model = found.with_candidates([id_]).model
    assert model.relay is not None
    assert sorted(gain for _, gain in model.relay.speed) == [-1.0, 1.0]
