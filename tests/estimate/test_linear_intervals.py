"""Intervals that take the model as linear, where it is and where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import calibration, fitted, parameter

from aero_bayes.estimate import LogUniform, Uniform

pytestmark = pytest.mark.fast
T = np.linspace(0.0, 4.0, 120)


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
