"""Recordings of a simulated rig that are left out and predicted by a fit to the others."""

from functools import partial

import numpy as np
import pytest

import simulated_rigs.aero as bench
from aero_bayes.errors import InputError
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.crossvalidation import leave_one_recording_out
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.model import Model

DELAYS = {"first": 0.004, "second": 0.011}
OPENED = partial(open_simulator, workers=0)


@pytest.fixture(scope="module")
def two_recordings(one_dof: Model):
    rng = np.random.default_rng(2)
    recordings = [
        bench.simulate_recording(
            bench.Truth((), delay), bench.random_levels(rng, 18.0, 10.0),
            bench.white(1.0), rng, duration=10.0, rate_hz=50.0, name=name,
        )
        for name, delay in DELAYS.items()
    ]  # fmt: skip
    settings = FitSettings(method="local", calibration=CalibrationSettings(delay="free", may_start_at_rest=("theta",)))
    return fit(recordings, one_dof, settings=settings, workers=0)


def test_a_left_out_recording_is_predicted_to_the_noise(two_recordings):
    left_out = leave_one_recording_out(two_recordings, OPENED, np.random.default_rng(1))
    assert [item.recording for item in left_out] == list(DELAYS)
    for item in left_out:
        for output, fitted in item.rms_fitted.items():
            assert fitted * 0.999 < item.rms[output] < 1.15 * fitted


def test_each_recording_has_its_delay(two_recordings):
    for name, delay in DELAYS.items():
        found = two_recordings[f"input_delay[{name}]"]
        assert abs(found.value - delay) < 4.5 * found.sd


def test_one_recording_cannot_be_left_out(two_recordings, one_dof: Model):
    alone = fit(two_recordings.calibration.data.recordings[0], one_dof, settings=FitSettings(method="local"), workers=0)
    with pytest.raises(InputError, match="at least two"):
        leave_one_recording_out(alone, OPENED, np.random.default_rng(1))
