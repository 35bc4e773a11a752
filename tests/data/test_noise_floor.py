"""The noise floor against noise of known size on top of an AERO's motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from aero_bayes.data import noise_floor, quantisation_step
from simulated_rigs.aero import Truth, even_times
from simulated_rigs.designs import random_levels

pytestmark = pytest.mark.fast

TIME = even_times(60.0, 100.0)
VOLTS = random_levels(np.random.default_rng(11), 20.0, 60.0).volts(TIME)
RUN = dict(zip(("i_m", "omega_m", "theta"), Truth().run(TIME, VOLTS)[0].T, strict=True))
INPUTS = [VOLTS]
SIZE = {"i_m": 5e-3, "omega_m": 1.0, "theta": 2e-3}


def slow_noise(rng: np.random.Generator, correlation_time: float) -> np.ndarray:
    keep = np.exp(-0.01 / correlation_time)
    return lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(TIME.size + 2000))[2000:]


@pytest.mark.parametrize("output", SIZE)
@pytest.mark.parametrize("level", [0.3, 1.0, 3.0])
def test_white_noise_within_five_percent(output: str, level: float) -> None:
    sd = level * SIZE[output]
    for seed in range(3):
        noise = sd * np.random.default_rng(seed).standard_normal(TIME.size)
        floor = noise_floor(RUN[output] + noise, TIME, INPUTS)
        assert floor.sd == pytest.approx(sd, rel=0.05)
        assert floor.slow == 0.0
        assert floor.quantum is None


@pytest.mark.parametrize(("output", "correlation_time"), [("i_m", 0.05), ("omega_m", 0.1), ("theta", 0.04)])
def test_noise_with_memory_is_told_from_the_signal(output: str, correlation_time: float) -> None:
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        noise = SIZE[output] * (0.5 * rng.standard_normal(TIME.size) + slow_noise(rng, correlation_time))
        floor = noise_floor(RUN[output] + noise, TIME, INPUTS)
        found.append((floor.white / SIZE[output], floor.slow / SIZE[output], floor.slow_time))
    white, slow, slow_time = np.median(found, axis=0)
    assert white == pytest.approx(0.5, rel=0.15)
    assert slow == pytest.approx(1.0, rel=0.3)
    assert slow_time == pytest.approx(correlation_time, rel=0.6)


def test_uneven_times_and_gaps() -> None:
    rng = np.random.default_rng(6)
    time = np.cumsum(rng.uniform(0.002, 0.02, 6000))
    values = np.sin(2.0 * np.pi * 0.3 * time) + 1e-3 * rng.standard_normal(time.size)
    values[rng.random(time.size) < 0.2] = np.nan
    floor = noise_floor(values, time)
    assert floor.sd == pytest.approx(1e-3, rel=0.06)


def test_quantised_readings_never_fall_below_the_quantum() -> None:
    step = 2.0 * np.pi / 2048.0
    quiet = np.round(RUN["theta"] / step) * step
    floor = noise_floor(quiet, TIME, INPUTS)
    assert floor.quantum == pytest.approx(step, rel=1e-6)
    assert step / np.sqrt(12.0) <= floor.sd < 1.3 * step / np.sqrt(12.0)
    standing = noise_floor(np.where(TIME < 30.0, 0.0, step), TIME)
    assert standing.quantum == pytest.approx(step, rel=1e-6)
    assert standing.sd == pytest.approx(step / np.sqrt(12.0), rel=1e-6)


@pytest.mark.parametrize("decimals", [4, 6, 9])
def test_quantum_survives_the_print_format(decimals: int) -> None:
    step = 2.0 * np.pi / 2048.0
    printed = np.round(np.round(RUN["theta"] / step) * step, decimals)
    assert quantisation_step(printed) == pytest.approx(step, rel=1e-3)


def test_continuous_readings_have_no_quantum() -> None:
    rng = np.random.default_rng(7)
    assert quantisation_step(RUN["theta"] + 1e-3 * rng.standard_normal(TIME.size)) is None
    assert quantisation_step(np.zeros(100)) is None
    irregular = rng.choice(np.cumsum(rng.uniform(0.5, 1.5, 40)), 2000)
    assert quantisation_step(irregular) is None


def test_too_few_readings_say_nothing() -> None:
    assert noise_floor(np.array([0.0, 1.0, np.nan, 2.0]), np.arange(4.0)).sd is None
