"""Encoder counts, made with a known size, must come back with it and leave the noise as it was."""

import numpy as np
import pytest

import simulated_rigs.aero as bench
from aero_bayes.estimate import NoiseModel
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.noise_estimation import describe_sensors, rounding_error, thin_constant_readings
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.model import Model

pytestmark = pytest.mark.fast


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return Model.load(export_fmu("Aero.Systems.OneDof", tmp_path_factory.mktemp("fmu") / "OneDof.fmu"))


def test_rounding_of_a_slow_signal_lasts():
    time = np.arange(0.0, 20.0, 0.01)
    fast = rounding_error(time, 400.0 * np.sin(time) + 3.0 * time**1.5, 1.0)
    assert fast.sd == pytest.approx(1.0 / np.sqrt(12.0), rel=0.05)
    slow = rounding_error(time, 3.0 * np.sin(0.4 * time), 1.0)
    assert slow.kind == "ou"
    assert slow.rho(0.01) > 0.7


@pytest.fixture(scope="module")
def counted(model):
    """A fit to a pitch encoder of 64 counts whose noise before rounding is a fifth of a count."""
    step = 2.0 * np.pi / 64
    sensors = bench.white() | {"theta": bench.SensorNoise(white=0.2 * step, counts=64)}
    levels = bench.random_levels(np.random.default_rng(6), 20.0, 10.0)
    recording = bench.simulate_recording(
        bench.Truth((), 0.006), levels, sensors,
        np.random.default_rng(7), duration=10.0, rate_hz=50.0,
    )  # fmt: skip
    settings = FitSettings(method="local", noise=NoiseModel("white"))
    return fit(recording, model, settings=settings, workers=0), step


def test_counts_are_described(counted):
    fitted, step = counted
    found = fitted.sensors["theta"].encoder
    assert found.step == pytest.approx(step, rel=1e-6)
    assert found.share == pytest.approx(1 / 12 / (1 / 12 + 0.04), abs=0.15)
    assert "i_m" not in fitted.sensors


@pytest.mark.parametrize("size", [0.1, 1.5])
def test_what_rounding_adds_is_told(size):
    time = np.arange(0.0, 40.0, 0.01)
    signal = 30.0 * np.sin(0.7 * time)
    readings = np.round(signal + size * np.random.default_rng(9).standard_normal(time.size))
    found = describe_sensors(["y"], [(time, readings[:, None], signal[:, None])])["y"].encoder
    assert found.step == pytest.approx(1.0)
    assert found.share == pytest.approx(1 / 12 / (1 / 12 + size**2), rel=0.1)


def test_standstill_keeps_three_of_a_long_stretch():
    time = np.arange(1000) * 0.01
    values = np.concatenate([np.arange(300.0), np.full(400, 7.0), np.arange(300.0)])
    values[500] = np.nan
    use = thin_constant_readings(time, values)
    assert use[:300].all()
    assert use[700:].all()
    assert use[300:700].sum() == 3
    assert not use[500]
