"""Counts that stand still, on signals made in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.estimate.noise_estimation import quantum, thin_constant_readings

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
