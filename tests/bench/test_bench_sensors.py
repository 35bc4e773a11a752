"""Sensors: sizes, correlation, quantisation, ripple and reproducibility of what they add."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from aero_bayes.errors import InputError
from simulated_rigs.aero import Truth, even_times, measure, simulate_recording, simulate_truth
from simulated_rigs.designs import Chirp, equal_steps, prbs, random_levels, random_multi_sine
from simulated_rigs.sensors import SensorNoise, clean, ornstein_uhlenbeck, quantise, real, white

pytestmark = pytest.mark.long

TIME = even_times(30.0, 200.0)
RUN = simulate_truth(Truth(), equal_steps([8.0, -12.0, 16.0], 9.0), TIME)


def test_clean_sensors_show_the_truth() -> None:
    recording = measure(RUN, clean(), np.random.default_rng(0))
    for output in ("i_m", "omega_m", "theta"):
        np.testing.assert_array_equal(recording.outputs[output], getattr(RUN, output))


def test_white_noise_has_its_size_and_is_normal() -> None:
    recording = measure(RUN, white(2.0), np.random.default_rng(1))
    for output, sd in (("i_m", 1e-2), ("omega_m", 2.0), ("theta", 4e-3)):
        noise = recording.outputs[output] - getattr(RUN, output)
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
    recording = measure(RUN, replace(clean(), encoder_counts=2048), np.random.default_rng(0))
    counts = recording.outputs["theta"] / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(recording.outputs["theta"] - RUN.theta).max() <= 0.5 * step * (1.0 + 1e-9)
    values = np.linspace(-1.0, 1.0, 5001)
    assert (np.diff(quantise(values, 2048)) >= 0.0).all()
    assert quantise(np.array([0.0, 0.4 * step, 0.6 * step, -0.6 * step]), 2048) == pytest.approx(
        [0.0, 0.0, step, -step]
    )


def test_ripple_follows_the_rotor() -> None:
    sensors = replace(clean(), i_m=SensorNoise(ripple=(0.0, 1e-2)))
    added = measure(RUN, sensors, np.random.default_rng(3)).outputs["i_m"] - RUN.i_m
    phase = np.exp(-2j * RUN.angle)
    weight = np.abs(RUN.speed) / 376.0
    assert 2.0 * abs((added * weight * phase).sum()) / (weight**2).sum() == pytest.approx(1e-2, rel=0.05)
    assert np.abs(added[: int(1.0 * 200)]).max() == 0.0


def test_missing_readings() -> None:
    recording = measure(RUN, replace(clean(), omega_m=SensorNoise(missing=0.25)), np.random.default_rng(4))
    assert np.isnan(recording.outputs["omega_m"]).mean() == pytest.approx(0.25, abs=0.03)
    assert np.isfinite(recording.outputs["theta"]).all()


def test_seed_decides_and_outputs_are_independent_of_each_other() -> None:
    first = measure(RUN, real(), np.random.default_rng(5))
    again = measure(RUN, real(), np.random.default_rng(5))
    other = measure(RUN, real(), np.random.default_rng(6))
    louder = measure(RUN, replace(real(), theta=SensorNoise(0.1)), np.random.default_rng(5))
    for output in first.outputs:
        np.testing.assert_array_equal(first.outputs[output], again.outputs[output])
        assert not np.array_equal(first.outputs[output], other.outputs[output])
    np.testing.assert_array_equal(first.outputs["i_m"], louder.outputs["i_m"])


def test_noise_without_a_generator_is_refused() -> None:
    with pytest.raises(InputError, match="random generator"):
        simulate_recording(Truth(), equal_steps([5.0], 1.0), white(), duration=2.0)


def test_unknown_effects_are_refused() -> None:
    from simulated_rigs.aero import EffectTruth, effect

    with pytest.raises(InputError, match="no effect magic"):
        effect("magic", size=1.0)
    with pytest.raises(InputError, match="brush_drop takes V_b"):
        effect("brush_drop", drop=1.0)
    with pytest.raises(InputError, match="no effect magic"):
        simulate_truth(Truth(effects=(EffectTruth("magic", "body", {}),)), equal_steps([5.0], 1.0), TIME)


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
