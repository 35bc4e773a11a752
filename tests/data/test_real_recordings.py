"""The measured AERO recordings, where they are at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from aero_recordings import read_aero

from aero_bayes.data import to_experiment

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data"
STEP, PULSE = FOLDER / "aero_step_16v5_1khz.csv", FOLDER / "aero_pitch_pulse_500hz.csv"
pytestmark = [
    pytest.mark.skipif(not STEP.exists(), reason="the measured recordings are not on this machine"),
    pytest.mark.fast,
]


def test_step() -> None:
    recording = read_aero(STEP)
    assert (recording.rows, recording.rate_hz, recording.duration) == (30001, pytest.approx(1000.0), 30.0)
    (signal,) = to_experiment(recording, zero_at_rest=("omega_m", "i_m")).inputs
    assert signal.values.tolist() == [0.0, 16.51376]
    current, speed, pitch = recording.summary().outputs
    assert current.noise.quantum == pytest.approx(0.403e-3, rel=1e-3)
    assert pitch.noise.quantum == pytest.approx(2.0 * np.pi / 2048.0, rel=1e-5)
    assert 1.0 < speed.noise.sd < 2.5


def test_pulse() -> None:
    recording = read_aero(PULSE)
    assert list(recording.outputs) == ["theta"]
    (signal,) = to_experiment(recording, zero_at_rest=("omega_m", "i_m")).inputs
    assert signal.values.tolist() == [0.0, -20.0, 0.0]
    assert signal.time.tolist() == pytest.approx([0.0, 1.0, 1.75])
    assert recording.summary().outputs[0].noise.quantum == pytest.approx(2.0 * np.pi / 2048.0, rel=1e-5)
