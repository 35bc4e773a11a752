"""A summary says what was put into the recording."""

from __future__ import annotations

import re

import numpy as np
import pytest
from facts import facts

from aero_bayes.data import Recording
from simulated_rigs.aero import Truth, simulate_recording
from simulated_rigs.designs import equal_steps
from simulated_rigs.sensors import SensorNoise, white

pytestmark = pytest.mark.fast

STAIRS = equal_steps([6.0, 18.0, 12.0, -9.0, 0.0], 5.0)


def made(sensors: dict[str, SensorNoise], seed: int = 0, rate_hz: float = 100.0) -> Recording:
    return simulate_recording(
        Truth(), STAIRS, sensors, np.random.default_rng(seed), duration=27.0, rate_hz=rate_hz, name="made"
    )


def test_sampling_input_and_gaps() -> None:
    recording = made({"theta": SensorNoise(white=1e-3, missing=0.1)})
    summary = recording.summary()
    assert (summary.rows, summary.rate_hz, summary.dropped) == (2701, pytest.approx(100.0), 0)
    (volts,) = summary.inputs
    assert (volts.levels, volts.jumps, volts.lowest, volts.highest) == (5, 5, -9.0, 18.0)
    assert volts.at_largest == pytest.approx(500 / 2701)
    theta = summary.outputs[2]
    assert theta.missing == int(np.isnan(recording.outputs["theta"]).sum()) > 0
    assert theta.noise.sd == pytest.approx(1e-3, rel=0.1)
    assert re.search(facts("made", "2,701"), str(summary))
    assert re.search(facts("V_m", "-9", "18 V", "5 levels"), summary._repr_html_())


def test_dropped_samples_and_jitter() -> None:
    recording = made({})
    keep = np.ones(recording.rows, dtype=bool)
    keep[100:110] = keep[500] = False
    rng = np.random.default_rng(1)
    cut = Recording(
        "cut",
        recording.time[keep] + rng.uniform(0.0, 1e-3, keep.sum()),
        {"V_m": recording.inputs["V_m"][keep]},
        {"theta": recording.outputs["theta"][keep]},
    )
    summary = cut.summary()
    assert summary.dropped == 11
    assert summary.longest_interval == pytest.approx(0.11, abs=2e-3)
    assert 0.01 < summary.jitter < 0.1


def test_saturated_sensor_is_seen_and_a_resting_encoder_is_not() -> None:
    recording = made(white() | {"theta": SensorNoise(1e-3)})
    clipped = dict(recording.outputs) | {"omega_m": np.minimum(recording.outputs["omega_m"], 300.0)}
    summary = Recording("clipped", recording.time, recording.inputs, clipped, recording.units).summary()
    share = float((clipped["omega_m"] == 300.0).mean())
    assert summary.outputs[1].saturated == pytest.approx(share, rel=0.05)
    assert summary.outputs[0].saturated == 0.0
    assert "saturated" in summary.outputs[1].text
    assert made({"theta": SensorNoise(counts=2048)}).summary().outputs[2].saturated == 0.0
