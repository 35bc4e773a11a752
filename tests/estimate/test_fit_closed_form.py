"""Fits of formulas: against scipy.optimize, and parameters known by construction; intervals and profiles."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import FormulaSimulator, calibration, fitted, parameter
from scipy.optimize import least_squares

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate import LogUniform, Normal, Uniform
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.levenberg_marquardt import FitSettings, LocalSettings
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.log_posterior import profile_likelihood
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.swarm import SwarmSettings

pytestmark = pytest.mark.fast

T = np.linspace(0.0, 4.0, 120)
SWARM = FitSettings(pso=SwarmSettings(particles=16, iterations=30))


def decay(t: np.ndarray, v: np.ndarray) -> np.ndarray:
    first = v[0] * np.exp(-v[1] * t)
    return np.stack([first, first * v[2] + v[3] * np.sin(v[4] * t)], axis=1)


def test_two_outputs_agree_with_scipy_at_the_same_weights() -> None:
    rng = np.random.default_rng(12)
    truth = np.array([2.0, 0.8, 0.5, 0.7, 3.0])
    y = decay(T, truth) + np.array([0.02, 0.3]) * rng.normal(size=(T.size, 2))
    y[rng.random(y.shape) < 0.1] = np.nan
    names = ["A", "r", "g", "B", "w"]
    items = [
        parameter(n, v * 1.15, 0.05, 20.0, LogUniform(0.05, 20.0), "log") for n, v in zip(names, truth, strict=True)
    ]
    found = fitted(decay, calibration([(T, y)], ["one", "two"], items))
    weight = np.array([found.noise["one"].sd_white, found.noise["two"].sd_white])
    seen = np.isfinite(y)
    reference = least_squares(lambda v: ((decay(T, v) - y) / weight)[seen], truth, xtol=1e-14, ftol=1e-14)
    np.testing.assert_allclose(found.values, reference.x, rtol=1e-3)
    assert [s.outputs for s in found.stages] == [("one",), ("two",), ("one", "two")]
    assert found.reason.converged
    errors = (found.values - truth) / (found.values * found.laplace.sd[:5])
    assert np.all(np.abs(errors) < 4.5)
    assert all(e.status is Status.IDENTIFIED for e in found.parameters.values())


def test_swarm_finds_the_basin_that_a_local_search_misses() -> None:
    def wave(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.sin(v[0] * t)[:, None]

    rng = np.random.default_rng(13)
    y = wave(T, np.array([7.0])) + 0.05 * rng.normal(size=(T.size, 1))
    problem = calibration([(T, y)], ["y"], [parameter("w", 1.0, 0.1, 30.0, LogUniform(0.1, 30.0), "log")])
    chain = fitted(wave, problem, FitSettings(pso=SwarmSettings(particles=30, iterations=40)))
    assert abs(fitted(wave, problem).values[0] - 7.0) > 1.0
    assert chain.values[0] == pytest.approx(7.0, abs=0.02)


def test_a_parameter_without_effect_is_unidentified_and_gets_no_error_bar() -> None:
    def blind(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (v[0] * np.exp(-t) + 0.0 * v[1])[:, None]

    rng = np.random.default_rng(14)
    y = blind(T, np.array([2.0, 1.0])) + 0.1 * rng.normal(size=(T.size, 1))
    items = [
        parameter("A", 1.0, 0.1, 9.0, Uniform(0.1, 9.0)),
        parameter("L_a", 0.3, 0.1, 9.0, LogUniform(0.1, 9.0), "log"),
    ]
    found = fitted(blind, calibration([(T, y)], ["y"], items), SWARM)
    estimate = found["L_a"]
    assert estimate.status is Status.UNIDENTIFIED
    assert estimate.sd is None
    assert estimate.q05 is None
    assert estimate.value == 0.3
    assert found["A"].sd is not None
    assert "L_a" in found.identifiability.no_effect


def test_sums_products_and_ratios_are_named() -> None:
    def mixed(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        j_r, j_s, k_t, d_t, j_p = v
        return np.stack([np.exp(-t / (j_r + j_s)), k_t * d_t / j_p * t], axis=1)

    rng = np.random.default_rng(15)
    truth = np.array([0.7, 0.4, 2.0, 0.5, 3.0])
    y = mixed(T, truth) + 0.02 * rng.normal(size=(T.size, 2))
    items = [
        parameter(n, v, v / 9, v * 9, LogUniform(v / 9, v * 9), "log")
        for n, v in zip(["J_r", "J_s", "k_t", "D_t", "J_p"], truth, strict=True)
    ]
    found = fitted(mixed, calibration([(T, y)], ["a", "b"], items))
    assert {c.text for c in found.identifiability.combinations} == {"J_r + J_s", "k_t D_t / J_p"}


def test_an_optional_parameter_is_freed_only_where_the_data_shows_it() -> None:
    def two_speeds(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (1.0 - v[0] * np.exp(-t / 0.8) - 0.5 * np.exp(-t / v[1]))[:, None]

    rng = np.random.default_rng(16)
    for times, shown in ((np.linspace(0.0, 3.0, 600), True), (np.linspace(1.0, 3.0, 100), False)):
        y = two_speeds(times, np.array([0.5, 0.02])) + 0.01 * rng.normal(size=(times.size, 1))
        items = [
            parameter("A", 0.4, 0.1, 9.0, Uniform(0.1, 9.0)),
            parameter("L_a", 0.03, 0.003, 0.3, LogUniform(0.003, 0.3), "log", free_if_identified=True),
        ]
        found = fitted(two_speeds, calibration([(times, y)], ["y"], items), SWARM)
        assert (found["L_a"].sd is not None) == shown
        assert found["L_a"].value == (pytest.approx(0.02, rel=0.3) if shown else 0.03)


def test_a_model_that_never_runs_is_said_in_one_line() -> None:
    problem = calibration([(T, T[:, None])], ["y"], [parameter("a", 0.0, -9.0, 9.0, Normal(0.0, 3.0))])
    with pytest.raises(CannotFinishError, match="not a finite number"):
        fitted(lambda t, v: t[:, None] * np.nan, problem, SWARM)


def test_a_range_far_wider_leaves_the_intervals_of_least_squares() -> None:
    """How sure a parameter is does not depend on how wide the range of another is."""
    rng = np.random.default_rng(17)
    time = 0.1 * np.arange(400)
    u = np.repeat(rng.uniform(-1.0, 1.0, 100), 4)
    y = 1.2 + 0.9 * u + 0.1 * rng.standard_normal(time.size)
    items = [parameter("a", 1.0, 0.0, 2.0, Uniform(0.0, 2.0)), parameter("b", 0.0, -1e6, 1e6, Uniform(-1e6, 1e6))]
    problem = calibration([(time, y[:, None])], ["y"], items)
    objective = Objective(problem, FormulaSimulator(problem.problem(), lambda t, v: (v[0] + 1e3 * v[1] * u)[:, None]))
    start = problem.parameters.to_search(problem.parameters.start)
    settings = LocalFitSettings(LocalSettings(tolerance=1e-9)).least_squares(["y"])
    found = local_fit(objective, start, (0, 1), settings=settings)
    rows = np.vstack([np.ones(u.size), u])
    (level, slope), *_ = np.linalg.lstsq(rows.T, y, rcond=None)
    left = y - np.array([level, slope]) @ rows
    exact = np.sqrt(np.diag(np.linalg.inv(rows @ rows.T)) * float(left @ left) / y.size)
    values = problem.parameters.from_search(found.coordinates)
    scale = problem.parameters.jacobian(values)
    assert values == pytest.approx([level, 1e-3 * slope], rel=1e-3)
    assert found.sd(0) * scale[0] == pytest.approx(exact[0], rel=0.02)
    assert found.sd(1) * scale[1] == pytest.approx(1e-3 * exact[1], rel=0.02)


def bent(power: int, slope: float):
    """Fit ``a + b**power t`` to noise about a line whose slope is so many of its standard deviations off zero."""
    rng = np.random.default_rng(3)
    noise = 0.2 * rng.normal(size=T.size)
    noise -= np.polyval(np.polyfit(T, noise, 1), T)
    sd = float(np.std(noise)) / np.sqrt(np.sum((T - T.mean()) ** 2))
    y = (1.0 + slope * sd * T + noise)[:, None]

    def line(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (v[0] + v[1] ** power * t)[:, None]

    start = (slope * sd) ** (1.0 / power)
    items = [
        parameter("a", 1.0, -9.0, 9.0, Uniform(-9.0, 9.0)),
        parameter("b", 1.1 * start, 0.0, 3.0, Uniform(0.0, 3.0)),
    ]
    return fitted(line, calibration([(T, y)], ["y"], items))


def test_a_linear_model_has_no_failed_interval() -> None:
    assert bent(1, 5.0).failed_intervals == {}


def test_where_the_model_bends_within_the_interval_it_is_told() -> None:
    found = bent(3, 0.25)
    assert "b" in found.failed_intervals
    assert "interval" in found.parameters["b"].note
    assert found.parameters["b"].status == "weak"  # identified would deny the note
    assert "interval" in found.summary()


def test_a_rate_that_is_too_fast_for_the_sampling_has_a_lower_end_only() -> None:
    rng = np.random.default_rng(7)
    y = (2.0 * (1.0 - np.exp(-80.0 * (T + 0.05))) + 0.05 * rng.normal(size=T.size))[:, None]

    def rise(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (v[0] * (1.0 - np.exp(-v[1] * (t + 0.05))))[:, None]

    items = [
        parameter("a", 1.0, -9.0, 9.0, Uniform(-9.0, 9.0)),
        parameter("k", 10.0, 0.05, 1e5, LogUniform(0.05, 1e5), scale="log"),
    ]
    found = fitted(rise, calibration([(T, y)], ["y"], items)).parameters["k"]
    assert "one-sided interval, > " in found.note
    assert 5.0 < float(found.note.split("> ")[1].split(":")[0]) < 90.0
    assert found.q05 is None
    assert found.q95 is None
    assert str(found.status) == "weak"


def test_a_bend_that_is_small_over_the_interval_is_not() -> None:
    assert bent(3, 30.0).failed_intervals == {}


def line(t: np.ndarray, v: np.ndarray) -> np.ndarray:
    return (v[0] + v[1] * t)[:, None]


def test_profile_of_a_linear_model_is_the_parabola_of_its_marginal() -> None:
    y = line(T, np.array([1.0, -0.5])) + 0.2 * np.random.default_rng(21).normal(size=(T.size, 1))
    items = [parameter("a", 0.0, -9.0, 9.0, Normal(0.0, 5.0)), parameter("b", 0.0, -9.0, 9.0, Normal(0.0, 3.0))]
    problem = calibration([(T, y)], ["y"], items)
    found = fitted(line, problem)
    result = profile_likelihood(found, "a", FormulaSimulator(problem.problem(), line), points=41)
    sd = found["a"].sd
    np.testing.assert_allclose(result.drop, 0.5 * ((result.values - found["a"].value) / sd) ** 2, atol=2e-2)
    low, high = result.interval
    assert low == pytest.approx(found["a"].value - 1.645 * sd, rel=0.01)
    assert high == pytest.approx(found["a"].value + 1.645 * sd, rel=0.01)
    assert result.bounded


def test_profile_of_a_product_is_flat_and_says_so() -> None:
    def product(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (v[0] * v[1] * t)[:, None]

    y = product(T, np.array([2.0, 0.5])) + 0.1 * np.random.default_rng(22).normal(size=(T.size, 1))
    items = [parameter(n, 1.0, 0.2, 5.0, LogUniform(0.2, 5.0), "log") for n in ("k_t", "D_t")]
    problem = calibration([(T, y)], ["y"], items)
    found = fitted(product, problem)
    result = profile_likelihood(found, "k_t", FormulaSimulator(problem.problem(), product))
    assert result.interval == (None, None)
    assert result.drop[5:15].max() < 0.05
    with pytest.raises(InputError, match="L_a"):
        profile_likelihood(found, "L_a", FormulaSimulator(problem.problem(), product))
