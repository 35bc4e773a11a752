"""Sensors and designs: sizes, correlation, quantisation, ripple and reproducibility of what they add."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from simulated_rigs.aero import Truth, even_times
from simulated_rigs.designs import Chirp, equal_steps, prbs, random_levels, random_multi_sine
from simulated_rigs.sensors import SensorNoise, ornstein_uhlenbeck, quantise, readings, real, white

pytestmark = pytest.mark.long

TIME = even_times(30.0, 200.0)
OUTPUTS, STATES = Truth().run(TIME, equal_steps([8.0, -12.0, 16.0], 9.0).volts(TIME))
CLEAN = dict(zip(("i_m", "omega_m", "theta"), OUTPUTS.T, strict=True))
ANGLE, SPEED = STATES[:, -1], STATES[:, 1]


def read(noise: dict[str, SensorNoise], seed: int) -> dict[str, np.ndarray]:
    return readings(np.random.default_rng(seed), TIME, CLEAN, noise, ANGLE, SPEED)


def test_sensors_without_noise_show_the_truth() -> None:
    found = read({}, 0)
    assert all(np.array_equal(found[output], values) for output, values in CLEAN.items())


def test_white_noise_has_its_size_and_is_normal() -> None:
    found = read(white(2.0), 1)
    for output, sd in (("i_m", 1e-2), ("omega_m", 2.0), ("theta", 4e-3)):
        noise = found[output] - CLEAN[output]
        assert kstest(noise / sd, "norm").pvalue > 1e-4
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4.5 / np.sqrt(noise.size)


@pytest.mark.parametrize("uneven", [False, True])
def test_slow_noise_has_its_correlation(uneven: bool) -> None:
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(0.002, 0.018, 40_000)) if uneven else np.arange(40_000) * 0.01
    noise = ornstein_uhlenbeck(rng, time, 0.08)
    assert noise.std() == pytest.approx(1.0, abs=0.06)
    # Normalised innovations are white and standard, whatever the spacing.
    keep = np.exp(-np.diff(time) / 0.08)
    innovations = (noise[1:] - keep * noise[:-1]) / np.sqrt(1.0 - keep**2)
    assert kstest(innovations, "norm").pvalue > 1e-4


def test_encoder_shows_whole_counts_within_half_a_step() -> None:
    step = 2.0 * np.pi / 2048.0
    theta = read({"theta": SensorNoise(counts=2048)}, 0)["theta"]
    np.testing.assert_allclose(theta / step, np.round(theta / step), atol=1e-9)
    assert np.abs(theta - CLEAN["theta"]).max() <= 0.5 * step * (1.0 + 1e-9)
    assert (np.diff(quantise(np.linspace(-1.0, 1.0, 5001), 2048)) >= 0.0).all()
    expected = [0.0, 0.0, step, -step]
    assert quantise(np.array([0.0, 0.4 * step, 0.6 * step, -0.6 * step]), 2048) == pytest.approx(expected)


def test_ripple_follows_the_rotor() -> None:
    added = read({"i_m": SensorNoise(ripple=(0.0, 1e-2))}, 3)["i_m"] - CLEAN["i_m"]
    weight = np.abs(SPEED) / 376.0
    amplitude = 2.0 * abs((added * weight * np.exp(-2j * ANGLE)).sum()) / (weight**2).sum()
    assert amplitude == pytest.approx(1e-2, rel=0.05)
    assert np.abs(added[: int(1.0 * 200)]).max() == 0.0


def test_missing_readings() -> None:
    found = read({"omega_m": SensorNoise(missing=0.25)}, 4)
    assert np.isnan(found["omega_m"]).mean() == pytest.approx(0.25, abs=0.03)
    assert np.isfinite(found["theta"]).all()


def test_seed_decides_and_outputs_are_independent_of_each_other() -> None:
    first, again, other = (read(real(), seed) for seed in (5, 5, 6))
    louder = read(real() | {"theta": SensorNoise(0.1)}, 5)
    for output in first:
        np.testing.assert_array_equal(first[output], again[output])
        assert not np.array_equal(first[output], other[output])
    np.testing.assert_array_equal(first["i_m"], louder["i_m"])


@pytest.mark.parametrize(
    "design",
    [
        random_levels(np.random.default_rng(0), 15.0, 30.0),
        prbs(np.random.default_rng(1), 15.0, 30.0),
        random_multi_sine(np.random.default_rng(2), 15.0),
        Chirp(15.0, 0.05, 2.0, 30.0),
    ],
)
def test_designs_stay_within_their_height_and_use_it(design) -> None:
    volts = design.volts(TIME)
    assert volts.shape == TIME.shape
    assert 0.6 * 15.0 < np.abs(volts).max() <= 15.0 * (1.0 + 1e-6)
