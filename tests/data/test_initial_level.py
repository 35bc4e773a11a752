"""Where readings begin, against what was simulated."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.data import initial_level

TIME = 2.0 + 0.01 * np.arange(600)
LAW_INTERFACES = {
    "rest": lambda t: 0.0 * t + 3.0,
    "ramp": lambda t: 3.0 - 5.0 * t,
    "fall": lambda t: 3.0 - 0.5 * 9.81 * t**2,
    "rise": lambda t: 4.0 - np.exp(-t / 0.05),
    "swing": lambda t: 3.0 * np.cos(9.0 * t),
}


#: Most error of each, in noise widths: a single reading is off by one, and 200 tries tell it to 5 %.
MOST = {"rest": 0.15, "ramp": 0.25, "fall": 0.35, "rise": 1.3, "swing": 1.3}


@pytest.mark.parametrize("shape", LAW_INTERFACES)
def test_a_slow_beginning_is_estimated_better_than_by_one_reading(shape):
    rng = np.random.default_rng(5)
    noise = 0.02
    truth = LAW_INTERFACES[shape](TIME - TIME[0])
    found = [initial_level(truth + rng.normal(0.0, noise, TIME.size), TIME, noise) for _ in range(200)]
    rms = float(np.sqrt(np.mean([(level - truth[0]) ** 2 for level, _ in found])))
    assert rms < MOST[shape] * noise
    # what it says of its own error is of the size of the error
    assert 0.5 * rms < np.sqrt(np.mean([sd**2 for _, sd in found])) < 2.0 * rms


def test_without_noise_the_first_reading_is_the_beginning():
    truth = LAW_INTERFACES["swing"](TIME - TIME[0])
    assert initial_level(truth, TIME, 0.0) == (truth[0], 0.0)
    line = 1.0 + 2.0 * (TIME - TIME[0])
    line[:2] = np.nan
    assert initial_level(line, TIME, 1e-6).level == pytest.approx(1.0, abs=1e-5)
    assert initial_level(np.full(600, np.nan), TIME, 1.0) is None
    assert initial_level(np.array([4.0]), TIME[:1], 1.0) == (4.0, 1.0)
