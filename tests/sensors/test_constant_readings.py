"""Counts that stand still, and ripple that folds onto slow physics, on signals made in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.sensors import find_ripple, quantum, thin_constant_readings

pytestmark = pytest.mark.fast


def test_quantum_is_found_on_counts_and_nowhere_else():
    rng = np.random.default_rng(1)
    step = 2 * np.pi / 2048
    smooth = 0.3 * np.sin(np.linspace(0, 20, 4000)) + 1e-4 * rng.normal(size=4000)
    assert quantum(np.round(smooth / step) * step) == pytest.approx(step, rel=1e-6)
    assert quantum(smooth) == 0.0
    assert quantum(np.zeros(100)) == 0.0


def test_standstill_keeps_three_of_a_long_stretch():
    time = np.arange(1000) * 0.01
    values = np.concatenate([np.arange(300.0), np.full(400, 7.0), np.arange(300.0)])
    values[500] = np.nan
    use = thin_constant_readings(time, values)
    assert use[:300].all()
    assert use[700:].all()
    assert use[300:700].sum() == 3
    assert not use[500]


def test_ripple_is_taken_out_and_slow_physics_stays():
    rng = np.random.default_rng(2)
    time = np.arange(6000) * 0.01
    speed = np.where(time < 30, 250.0, 180.0) + 5 * np.sin(time)
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.01)))
    ripple = 4.0 * np.sin(2 * angle + 0.4)
    physics = 1.5 * np.sin(2 * np.pi * 0.3 * time)
    noise = rng.normal(size=6000)
    found = find_ripple(time, ripple + physics + noise, speed)
    assert [o.order for o in found.orders] == [2]
    assert found.orders[0].amplitude == pytest.approx(4.0, rel=0.15)
    left = ripple - found.values
    inside = (time > 2) & (time < 58) & (np.abs(time - 30) > 2)
    assert np.sqrt(np.mean(left[inside] ** 2)) < 0.35


def test_ripple_with_a_slow_alias_is_left_alone():
    """At 100 readings a second a ripple of 100.2 Hz looks like one of 0.2 Hz, which no one can tell from physics."""
    rng = np.random.default_rng(4)
    time = np.arange(6000) * 0.01
    speed = np.where(time < 30, 250.0, 100.0 * np.pi + 0.5)
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.01)))
    found = find_ripple(time, 4.0 * np.sin(2 * angle) + rng.normal(size=6000), speed)
    assert [o.order for o in found.orders] == [2]
    assert not found.values[time > 31].any()
    assert np.std(found.values[time < 29]) == pytest.approx(4.0 / np.sqrt(2.0), rel=0.1)
