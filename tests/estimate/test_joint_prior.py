"""A posterior as the prior of the next experiment: the same as fitting both experiments at once."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import aero_bayes
from aero_bayes import InputError
from aero_bayes.estimate.parameters import ParameterSet, ParameterSpec, parameters_from_model, with_joint_prior

pytestmark = pytest.mark.fast

SD = 0.1


def model() -> aero_bayes.FunctionModel:
    def line(parameters, inputs, time):
        return {"y": parameters["a"] + parameters["b"] * inputs["u"](time)}

    return aero_bayes.FunctionModel(line, inputs=["u"], outputs=["y"], parameters={"a": 1.0, "b": 1.0})


def recording(name: str, low: float, high: float, seed: int) -> aero_bayes.Recording:
    rng = np.random.default_rng(seed)
    time, u = np.arange(200.0), rng.uniform(low, high, 200)
    return aero_bayes.Recording(name, time, {"u": u}, {"y": 2.0 + 3.0 * u + SD * rng.normal(size=200)})


def parameters() -> ParameterSet:
    wide = {name: ParameterSpec(start=1.0, lower=-10.0, upper=10.0) for name in ("a", "b")}
    return parameters_from_model(model(), overrides=wide)


def line_of(*recordings: aero_bayes.Recording) -> tuple[np.ndarray, np.ndarray]:
    """Least squares in closed form: values and covariance of a and b."""
    u, y = (np.concatenate([r.inputs["u"] for r in recordings]), np.concatenate([r.outputs["y"] for r in recordings]))
    design = np.column_stack([np.ones_like(u), u])
    covariance = SD**2 * np.linalg.inv(design.T @ design)
    return np.linalg.lstsq(design, y, rcond=None)[0], covariance


def test_the_density_is_that_of_a_normal_distribution() -> None:
    rng = np.random.default_rng(3)
    mean, covariance = np.array([np.log(4.0), 0.5]), np.array([[0.04, 0.054], [0.054, 0.09]])
    draws = rng.multivariate_normal(mean, covariance, 4000)
    given = {"a": np.exp(draws[:, 0]), "b": draws[:, 1]}
    own = {"a": ParameterSpec(start=4.0, lower=1e-3, upper=1e3), "b": ParameterSpec(start=0.5, lower=-20.0, upper=20.0)}
    found = with_joint_prior(parameters_from_model(model(), overrides=own), given)
    exact = multivariate_normal(draws.mean(axis=0), np.cov(draws.T))
    points = rng.multivariate_normal(mean, covariance, 20) / [1.0, 40.0]
    # The search's axes are ln a and b over the width of its bounds.
    assert found.log_prior(points) == pytest.approx(exact.logpdf(points * [1.0, 40.0]) + np.log(40.0), abs=1e-6)
    first, second = found.prior_derivatives(points)
    step = 1e-6
    for k in range(2):
        ahead, behind = points + step * np.eye(2)[k], points - step * np.eye(2)[k]
        slope = (found.log_prior(ahead) - found.log_prior(behind)) / (2 * step)
        assert first[:, k] == pytest.approx(slope, rel=1e-4, abs=1e-3)
    unit = np.diag([1.0, 1.0 / 40.0])
    expected = np.linalg.inv(unit @ np.cov(draws.T) @ unit)
    assert found.prior_curvature(second[0], [0, 1]) == pytest.approx(expected, rel=1e-6)
    again = found.sample_prior(rng, 4000)
    assert np.corrcoef(np.log(again[:, 0]), again[:, 1])[0, 1] == pytest.approx(0.9, abs=0.02)


def test_two_experiments_after_each_other_are_as_good_as_both_at_once() -> None:
    """Neither tells a and b apart by itself; the correlation of the first is what the second needs."""
    first, second = recording("first", 4.9, 5.1, 1), recording("second", 0.9, 1.1, 2)
    values, covariance = line_of(first)
    draws = np.random.default_rng(5).multivariate_normal(values, covariance, 20_000)
    known = with_joint_prior(parameters(), {"a": draws[:, 0], "b": draws[:, 1]})
    found = aero_bayes.fit([second], model(), parameters=known, seed=1, workers=1)
    exact, spread = line_of(first, second)
    for k, name in enumerate(("a", "b")):
        estimate = found.parameters[name]
        assert estimate.value == pytest.approx(exact[k], abs=0.3 * np.sqrt(spread[k, k]))
        assert estimate.sd == pytest.approx(np.sqrt(spread[k, k]), rel=0.25)
        alone = np.sqrt(line_of(second)[1][k, k])
        assert estimate.sd < 0.25 * alone


def test_a_posterior_of_other_parameters_is_refused() -> None:
    with pytest.raises(InputError, match="none of the parameters a, b; it has c"):
        with_joint_prior(parameters(), {"c": np.ones(100)})
    with pytest.raises(InputError, match="5 draws, expected 10"):
        with_joint_prior(parameters(), {"a": np.arange(5.0)})
