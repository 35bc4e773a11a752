"""The test of correlation between innovations: its size under independence, and its power."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.estimate.noise import correlation_p_value

pytestmark = pytest.mark.fast

RUNS, N = 2000, 1000


def test_the_test_keeps_its_size_within_and_between_series():
    """2,000 p-values each: a tenth lies below 0.1, uncertain by 0.0067; the chi-square law is approximate."""
    rng = np.random.default_rng(1)
    scale = 1.0 + 0.8 * np.sin(np.linspace(0.0, 9.0, N))
    series = scale * rng.standard_normal((RUNS, 2, N))
    within = [correlation_p_value(a, a) for a, _ in series]
    between = [correlation_p_value(a, b) for a, b in series]
    for p in (within, between):
        assert abs(np.mean(np.array(p) < 0.1) - 0.1) < 0.03
        assert abs(np.mean(np.array(p) < 0.5) - 0.5) < 0.06


def test_short_series_do_not_fail_too_often():
    """75 values: of 4,000 independent series 4 are expected below 1e-3; 20 or more are so with a chance below 1e-7."""
    rng = np.random.default_rng(3)
    p = [correlation_p_value(a, a) for a in rng.standard_normal((4000, 75))]
    assert np.sum(np.array(p) < 1e-3) < 20


def test_a_common_part_of_two_white_series_is_seen():
    """Each is white by itself; a common part of a quarter of the variance is beyond chance in every run."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        common = rng.standard_normal(4 * N)
        a, b = (0.87 * rng.standard_normal(4 * N) + 0.5 * np.roll(common, shift) for shift in (0, 3))
        assert correlation_p_value(a, b) < 1e-4
