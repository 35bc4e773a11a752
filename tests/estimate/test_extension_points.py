"""A prior that a user brings along."""

from __future__ import annotations

import re
from dataclasses import dataclass

import closed_form
import numpy as np
import pytest
from facts import facts
from scipy.stats import gamma

pytestmark = pytest.mark.fast


@dataclass(frozen=True)
class Gamma:
    """A gamma prior between bounds: everything that a prior must have."""

    shape: float
    rate: float
    lower: float = 0.0
    upper: float = np.inf

    def log_pdf(self, x):
        law = gamma(self.shape, scale=1.0 / self.rate)
        inside = (np.asarray(x) >= self.lower) & (np.asarray(x) <= self.upper)
        return np.where(inside, law.logpdf(x) - np.log(law.cdf(self.upper) - law.cdf(self.lower)), -np.inf)

    def derivatives(self, x):
        return (self.shape - 1.0) / x - self.rate, -(self.shape - 1.0) / x**2

    def sample(self, rng, size):
        return np.clip(rng.gamma(self.shape, 1.0 / self.rate, size), self.lower, self.upper)

    def bounded(self, lower, upper):
        return Gamma(self.shape, self.rate, max(lower, self.lower), min(upper, self.upper))

    def describe(self, unit):
        return f"gamma of shape {self.shape:g} and rate {self.rate:g} per {unit}"


def test_a_user_brings_a_prior_of_his_own():
    """A level k with a gamma prior under known white noise: the mode is the root of a quadratic."""
    rng = np.random.default_rng(2)
    time = np.arange(40.0)
    y = 2.0 + 3.0 * rng.standard_normal((time.size, 1))
    items = [closed_form.parameter("k", 1.0, 0.01, 20.0, Gamma(9.0, 3.0))]
    problem = closed_form.calibration([(time, y)], ["y"], items)
    found = closed_form.fitted(lambda t, v: v[0] + 0.0 * t[:, None], problem)
    precision = time.size / found.noise["y"].sd_white ** 2
    b = precision * y.mean() - 3.0
    assert found["k"].value == pytest.approx((b + np.sqrt(b * b + 4.0 * precision * 8.0)) / (2.0 * precision), rel=2e-3)
    assert found["k"].value > y.mean() + 0.02
    assert re.match(facts("gamma", "9", "3"), found["k"].prior)
