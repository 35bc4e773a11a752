"""Profiles against closed forms; the unscaled searches fail where the scaled ones do not."""

from __future__ import annotations

import numpy as np
import pytest
from aero_bayes.inference.unscaled import Eq6Cost, unscaled_local, unscaled_swarm
from closed_form import FormulaSimulator, calibration, parameter

from aero_bayes.check.profile import profile
from aero_bayes.errors import InputError
from aero_bayes.estimate import FitSettings, LogUniform, Normal, SwarmSettings, fit_calibration

T = np.linspace(0.0, 4.0, 120)


def line(t: np.ndarray, v: np.ndarray) -> np.ndarray:
    return (v[0] + v[1] * t)[:, None]


def test_profile_of_a_linear_model_is_the_parabola_of_its_marginal() -> None:
    y = line(T, np.array([1.0, -0.5])) + 0.2 * np.random.default_rng(21).normal(size=(T.size, 1))
    items = [parameter("a", 0.0, -9.0, 9.0, Normal(0.0, 5.0)), parameter("b", 0.0, -9.0, 9.0, Normal(0.0, 3.0))]
    problem = calibration([(T, y)], ["y"], items)
    found = fit_calibration(problem, lambda p: FormulaSimulator(p, line), FitSettings(method="local"))
    result = profile(found, "a", FormulaSimulator(problem.problem(), line), points=41)
    sd = found.parameters["a"].sd
    np.testing.assert_allclose(result.drop, 0.5 * ((result.values - found.value("a")) / sd) ** 2, atol=2e-2)
    low, high = result.interval
    assert low == pytest.approx(found.value("a") - 1.645 * sd, rel=0.01)
    assert high == pytest.approx(found.value("a") + 1.645 * sd, rel=0.01)
    assert result.bounded


def test_profile_of_a_product_is_flat_and_says_so() -> None:
    def product(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (v[0] * v[1] * t)[:, None]

    y = product(T, np.array([2.0, 0.5])) + 0.1 * np.random.default_rng(22).normal(size=(T.size, 1))
    items = [parameter(n, 1.0, 0.2, 5.0, LogUniform(0.2, 5.0), "log") for n in ("k_t", "D_t")]
    problem = calibration([(T, y)], ["y"], items)
    found = fit_calibration(problem, lambda p: FormulaSimulator(p, product), FitSettings(method="local"))
    result = profile(found, "k_t", FormulaSimulator(problem.problem(), product))
    assert result.interval == (None, None)
    assert result.drop[5:15].max() < 0.05
    with pytest.raises(InputError, match="L_a"):
        profile(found, "L_a", FormulaSimulator(problem.problem(), product))


def test_absolute_steps_and_unscaled_axes_miss_what_scaled_ones_find() -> None:
    def motor(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return ((1.0 - np.exp(-t / (2e5 * v[0]))) / v[1])[:, None]

    truth = np.array([4e-6, 8.4])
    y = motor(T, truth) + 0.001 * np.random.default_rng(23).normal(size=(T.size, 1))
    low, high = np.array([1e-9, 0.1]), np.array([1e2, 1e2])
    items = [
        parameter(n, s, a, b, LogUniform(a, b), "log")
        for n, s, a, b in zip(["J_r", "R_a"], [2e-5, 6.0], low, high, strict=True)
    ]
    problem = calibration([(T, y)], ["y"], items)
    simulator = FormulaSimulator(problem.problem(), motor)
    cost = Eq6Cost(problem, simulator, ["J_r", "R_a"], problem.parameters.start)
    floor = float(cost(truth[None])[0])
    swarm = unscaled_swarm(cost, low, high, np.random.default_rng(24), particles=8, iterations=60)
    local = unscaled_local(cost, problem.parameters.start, low, high)
    settings = FitSettings(swarm=SwarmSettings(particles=16, iterations=40))
    scaled = fit_calibration(problem, lambda p: FormulaSimulator(p, motor), settings, np.random.default_rng(25))
    assert scaled.cost_eq6 < 1.1 * floor
    np.testing.assert_allclose(scaled.values, truth, rtol=0.01)
    assert swarm.cost > 10 * floor
    assert local.cost > 10 * floor
    fine = unscaled_local(Eq6Cost(problem, simulator, ["R_a"], truth), np.array([6.0]), low[1:], high[1:], step=1e-6)
    assert fine.values[0] == pytest.approx(8.4, rel=0.01)


def test_eq6_counts_readings_of_the_chosen_outputs_only() -> None:
    def two(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([v[0] * t, v[0] + 0 * t], axis=1)

    y = np.zeros((T.size, 2))
    y[3, 0] = np.nan
    problem = calibration([(T, y)], ["a", "b"], [parameter("k", 1.0, 0.1, 9.0, Normal(1.0, 5.0))])
    simulator = FormulaSimulator(problem.problem(), two)
    seen = np.delete(T, 3)
    values = np.array([[1.0], [2.0]])
    start = problem.parameters.start
    both = Eq6Cost(problem, simulator, ["k"], start)(values)
    np.testing.assert_allclose(both, [np.sum(seen**2) + 120, 4 * np.sum(seen**2) + 480])
    np.testing.assert_allclose(Eq6Cost(problem, simulator, ["k"], start, ["b"])(values), [120, 480])
