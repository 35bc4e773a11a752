"""More than one answer is told, and one answer is not told as two: models with known optima, over many recordings."""

from __future__ import annotations

import closed_form
import numpy as np
import pytest
from closed_form import calibration, parameter

from aero_bayes.estimate import NoiseModel, Uniform
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.swarm import SwarmSettings

TIME = np.linspace(0.0, 10.0, 120)
SETTINGS = FitSettings(pso=SwarmSettings(particles=16, iterations=40))
SEEDS = range(6)


def squared(time, p):
    return (p[..., 0] ** 2 * (1.0 - np.exp(-time / p[..., 1])))[:, None]


def plain(time, p):
    return (p[..., 0] * (1.0 - np.exp(-time / p[..., 1])))[:, None]


def ridge(time, p):
    """Only the product is seen: a line of equal optima is no second answer."""
    return (p[..., 0] * p[..., 1] * np.sin(time))[:, None]


def fitted(formula, names, truth, seed, low, high):
    rng = np.random.default_rng(seed)
    y = formula(TIME, np.array(truth)) + 0.02 * rng.standard_normal((TIME.size, 1))
    items = [
        parameter(n, 0.4 * a + 0.6 * b, a, b, Uniform(a, b), "linear") for n, a, b in zip(names, low, high, strict=True)
    ]
    problem = calibration([(TIME, y)], ["y"], items, NoiseModel())
    return closed_form.fitted(formula, problem, SETTINGS, seed)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_sign_that_is_squared(seed: int):
    found = fitted(squared, ("b", "tau"), (1.2, 2.0), seed, (-5.0, 0.1), (5.0, 20.0))
    (mode,) = found.modes
    assert mode.values["b"] == pytest.approx(-found["b"].value, abs=1e-3)
    assert mode.share == pytest.approx(0.5, abs=0.02)
    assert found.to_dict()["fit"]["modes"][0]["values"]["b"] == mode.values["b"]
    assert found.diagnosis["search"].found
    assert "b = " in found.diagnosis["search"].what


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("formula", [plain, ridge])
def test_one_answer_is_not_told_as_two(formula, seed: int):
    found = fitted(formula, ("a", "b"), (1.2, 2.0), seed, (-5.0, 0.1), (5.0, 20.0))
    assert found.modes == ()
