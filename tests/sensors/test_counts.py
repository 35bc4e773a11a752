"""Encoder counts, made with a known size, must come back with it and leave the noise as it was."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

import simulated_rigs.aero as bench
from aero_bayes.estimate import NoiseModel
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.quantisation import describe_quantisation, interval_log_density, rounding_error
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.model import Model

pytestmark = pytest.mark.fast


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return Model.load(export_fmu("Aero.Systems.OneDof", tmp_path_factory.mktemp("fmu") / "OneDof.fmu"))


def test_interval_density_is_the_probability_of_a_count():
    step, sd = 0.3, 0.07
    counts = step * np.arange(-3, 4)
    density = interval_log_density(counts, np.full(7, 0.11), sd, step)
    for value, count in zip(density, counts, strict=True):
        mass = quad(norm(0.11, sd).pdf, count - step / 2, count + step / 2)[0]
        assert np.exp(value) * step == pytest.approx(mass, rel=1e-6, abs=1e-12)
    assert np.exp(density).sum() * step == pytest.approx(1.0, abs=1e-9)
    fine = interval_log_density(np.array([0.2, 5.0]), np.array([0.1, 0.1]), 0.5, 1e-4)
    assert fine == pytest.approx(norm(0.1, 0.5).logpdf([0.2, 5.0]), abs=1e-6)
    assert interval_log_density(np.array([np.nan]), np.array([0.0]), 1.0, 0.1)[0] == 0.0


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
    sensors = bench.Sensors(
        bench.SensorNoise(white=0.005),
        bench.SensorNoise(white=1.0),
        bench.SensorNoise(white=0.2 * step),
        encoder_counts=64,
    )
    levels = bench.random_levels(np.random.default_rng(6), 20.0, 10.0)
    recording = bench.simulate_recording(
        bench.Truth("one_dof", bench.Parameters(), (), 0.006), levels, sensors,
        np.random.default_rng(7), duration=10.0, rate_hz=50.0,
    )  # fmt: skip
    settings = FitSettings(method="local", noise=NoiseModel("white"))
    return fit(recording, model, settings=settings, workers=0), step


def test_counts_are_described(counted):
    fitted, step = counted
    time, readings, smooth = (
        fitted.calibration.data.experiments[0].time,
        fitted.calibration.data.readings[0],
        fitted.fitted[0],
    )
    found = describe_quantisation(time, readings[:, 2], smooth[:, 2])
    assert found.step == pytest.approx(step, rel=1e-6)
    assert found.sd == pytest.approx(0.2 * step, rel=0.25)
    assert found.share == pytest.approx(1 / 12 / (1 / 12 + 0.04), abs=0.15)
    assert found.gain > 0.0
    assert describe_quantisation(time, readings[:, 0], smooth[:, 0]) is None
    assert fitted.sensors["theta"]["encoder"]["step"] == pytest.approx(step, rel=1e-6)


@pytest.mark.parametrize(("size", "exact"), [(0.1, True), (1.5, False)])
def test_exact_likelihood_is_asked_for_where_counts_are_coarse(size, exact):
    time = np.arange(0.0, 40.0, 0.01)
    signal = 30.0 * np.sin(0.7 * time)
    readings = np.round(signal + size * np.random.default_rng(9).standard_normal(time.size))
    found = describe_quantisation(time, readings, signal)
    assert found.exact is exact
    assert found.step == pytest.approx(1.0)
    assert found.sd == pytest.approx(size, rel=0.05)
    assert found.share == pytest.approx(1 / 12 / (1 / 12 + size**2), rel=0.1)
