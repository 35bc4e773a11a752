"""Profiles against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import FormulaSimulator, calibration, fitted, parameter

from aero_bayes.errors import InputError
from aero_bayes.estimate import LogUniform, Normal
from aero_bayes.estimate.target import profile_likelihood

pytestmark = pytest.mark.fast

T = np.linspace(0.0, 4.0, 120)


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
