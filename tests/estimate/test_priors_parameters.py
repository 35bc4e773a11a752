"""Priors, also from the posterior of another experiment, against SciPy; the change of variables against differences."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import closed_form
import numpy as np
import pytest
from closed_form import parameter
from facts import facts
from scipy import stats

import aero_bayes
from aero_bayes import load_model
from aero_bayes.errors import InputError
from aero_bayes.estimate import LogNormal, LogUniform, Normal, ParameterSpec, Uniform, parameters_from_model
from aero_bayes.estimate.parameters import ParameterSet, with_joint_prior

pytestmark = pytest.mark.fast

#: A prior, and the law of SciPy of which it is the part between its bounds.
PRIORS = [
    (Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
    (LogUniform(1e-3, 1e2), stats.loguniform(1e-3, 1e2)),
    (Normal(1.0, 2.0), stats.norm(1.0, 2.0)),
    (Normal(1.0, 0.5, 0.2, 1.4), stats.norm(1.0, 0.5)),
    (Normal(-3.0, 0.4, 0.5, 2.0), stats.norm(-3.0, 0.4)),
    (Normal(0.0, 1.0, 30.0, 31.0), stats.norm(0.0, 1.0)),
    (LogNormal(0.042, 0.1), stats.lognorm(0.1, scale=0.042)),
    (LogNormal(2.0, 0.8, 0.5, 3.0), stats.lognorm(0.8, scale=2.0)),
    (LogNormal(1.0, 0.3, 4.0, 9.0), stats.lognorm(0.3, scale=1.0)),
]


@pytest.mark.parametrize(("prior", "whole"), PRIORS, ids=lambda given: repr(given)[:40])
def test_density_and_draws_are_those_of_scipy(prior: object, whole: object) -> None:
    above = whole.sf(prior.lower)
    inside = above - whole.sf(prior.upper)
    x = whole.isf(above - inside * np.linspace(0.01, 0.99, 25))
    np.testing.assert_allclose(prior.log_pdf(x), whole.logpdf(x) - np.log(inside), rtol=1e-10, atol=1e-9)
    draws = prior.sample(np.random.default_rng(3), 4000)
    assert draws.min() >= prior.lower
    assert draws.max() <= prior.upper
    assert stats.kstest(draws, lambda x: (above - whole.sf(x)) / inside).pvalue > 1e-4


def sample_set() -> ParameterSet:
    return ParameterSet(
        (
            parameter("a", 2.0, 0.5, 8.0, LogNormal(2.0, 0.5), "log"),
            parameter("b", 2.0, 0.5, 8.0, Normal(3.0, 1.0), "log"),
            parameter("c", 0.0, -4.0, 6.0, Normal(0.5, 2.0), "linear"),
            parameter("d", 1.0, 0.1, 10.0, LogUniform(0.1, 10.0), "log"),
            parameter("e", 1.0, 0.1, 10.0, LogNormal(1.0, 0.4), "linear"),
        )
    )


def test_round_trip_and_jacobian() -> None:
    s = sample_set()
    values = s.sample_prior(np.random.default_rng(4), 50)
    u = s.to_search(values)
    np.testing.assert_allclose(s.from_search(u), values, rtol=1e-13)
    h = 1e-6
    for j in range(len(s)):
        step = np.zeros(len(s))
        step[j] = h
        slope = (s.from_search(u + step) - s.from_search(u - step))[:, j] / (2 * h)
        inside = (values[:, j] > 1.01 * s.items[j].lower) & (values[:, j] < 0.99 * s.items[j].upper)
        np.testing.assert_allclose(slope[inside], s.jacobian(values)[inside, j], rtol=1e-6)


def test_the_joint_density_and_its_derivatives_are_right() -> None:
    s = sample_set()
    low, high = s.box
    centre = s.to_search(s.start)
    total = 0.0
    for j in range(len(s)):
        total += float(s.items[j].prior.log_pdf(s.items[j].start)) + math.log(s.jacobian(s.start)[j])
    assert s.log_prior(centre[None])[0] == pytest.approx(total)
    rng = np.random.default_rng(5)
    for _ in range(20):
        u = low + (0.1 + 0.8 * rng.random(len(s))) * (high - low)
        first, second = s.prior_derivatives(u)
        h = 1e-4
        for j in range(len(s)):
            e = np.zeros(len(s))
            e[j] = h
            up, mid, down = s.log_prior(np.stack([u + e, u, u - e]))
            assert first[j] == pytest.approx((up - down) / (2 * h), rel=1e-5, abs=1e-5)
            assert second[j] == pytest.approx((up - 2 * mid + down) / h**2, rel=1e-4, abs=1e-4)


def test_outside_the_box_has_no_density() -> None:
    s = sample_set()
    low, high = s.box
    points = np.tile(s.to_search(s.start), (4, 1))
    points[0, 0], points[1, 2] = low[0] - 1e-9, high[2] + 1e-9
    points[2:] = [[-1e4], [1e4]]  # beyond any number: no warning either
    with np.errstate(all="raise"):
        assert np.all(s.log_prior(points) == -np.inf)


@pytest.mark.parametrize(
    ("start", "lower", "upper", "scale", "says"),
    [(9.0, 0.5, 8.0, "linear", "outside"), (1.0, 8.0, 0.5, "linear", "interval"), (1.0, -1.0, 8.0, "log", "positive")],
)
def test_bad_bounds_are_one_clear_line(start: float, lower: float, upper: float, scale: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        parameter("R_a", start, lower, upper, Uniform(-10.0, 10.0), scale)
    assert "R_a" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_widest_logarithmic_range_has_a_finite_density() -> None:
    tiny = float(np.finfo(float).tiny)
    sd = ParameterSet((parameter("T", 0.5, tiny, 500.0, LogUniform(tiny, 500.0), "log"),)).prior_sd()
    assert sd[0] == pytest.approx((math.log(500.0) - math.log(tiny)) / math.sqrt(12.0), rel=1e-3)


def test_a_bound_small_beyond_measure_says_only_the_sign(tmp_path) -> None:
    source = tmp_path / "Lag.mo"
    source.write_text(
        "model Lag\n  parameter Real T(unit=\"s\", min=2.2e-308) = 0.5;\n  parameter Real g(min=0.1) = 2;\n"
        "  input Real u;\n  output Real y(start=0, fixed=true);\nequation\n  T*der(y) = g*u - y;\nend Lag;\n", "utf-8",
    )  # fmt: skip
    model = load_model("Lag", sources=[source])
    found = parameters_from_model(model, ["T", "g"])
    assert (found["T"].lower, found["g"].lower) == (0.5e-3, 0.1)
    asked = parameters_from_model(model, ["T"], {"T": ParameterSpec(lower=1e-13)})
    assert asked["T"].lower == 1e-13


@dataclass(frozen=True)
class Gamma:
    """A gamma prior between bounds: everything that a prior must have."""

    shape: float
    rate: float
    lower: float = 0.0
    upper: float = np.inf

    def log_pdf(self, x):
        law = stats.gamma(self.shape, scale=1.0 / self.rate)
        inside = (np.asarray(x) >= self.lower) & (np.asarray(x) <= self.upper)
        return np.where(inside, law.logpdf(x) - np.log(law.cdf(self.upper) - law.cdf(self.lower)), -np.inf)

    def derivatives(self, x):
        return (self.shape - 1.0) / x - self.rate, -(self.shape - 1.0) / x**2

    def sample(self, rng, size):
        return np.clip(rng.stats.gamma(self.shape, 1.0 / self.rate, size), self.lower, self.upper)

    def bounded(self, lower, upper):
        return Gamma(self.shape, self.rate, max(lower, self.lower), min(upper, self.upper))

    def describe(self, unit):
        return f"gamma of shape {self.shape:g} and rate {self.rate:g} per {unit}"


def test_a_user_brings_a_prior_of_his_own():
    """A level k with a gamma prior under known white noise: the mode is the root of a quadratic."""
    rng = np.random.default_rng(2)
    time = np.arange(40.0)
    y = 2.0 + 3.0 * rng.standard_normal((time.size, 1))
    items = [parameter("k", 1.0, 0.01, 20.0, Gamma(9.0, 3.0))]
    problem = closed_form.calibration([(time, y)], ["y"], items)
    found = closed_form.fitted(lambda t, v: v[0] + 0.0 * t[:, None], problem)
    precision = time.size / found.noise["y"].sd_white ** 2
    b = precision * y.mean() - 3.0
    assert found["k"].value == pytest.approx((b + np.sqrt(b * b + 4.0 * precision * 8.0)) / (2.0 * precision), rel=2e-3)
    assert found["k"].value > y.mean() + 0.02
    assert re.match(facts("gamma", "9", "3"), found["k"].prior)


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
    exact = stats.multivariate_normal(draws.mean(axis=0), np.cov(draws.T))
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
