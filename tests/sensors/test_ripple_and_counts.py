"""Ripple and encoder counts, made with known sizes, must come back with them and leave the noise as it was."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import savgol_filter
from scipy.stats import norm

import simulated_rigs.aero as bench
from aero_bayes.data import read_recording
from aero_bayes.estimate import FitSettings, NoiseModel, fit, without_ripple
from aero_bayes.export import export_fmu
from aero_bayes.sensors import describe_quantisation, find_ripple, interval_log_density, rounding_error
from aero_bayes.simulation import Model
from aero_bayes.workflow import ripple_series

pytestmark = pytest.mark.fast

STEP_RECORDING = Path(__file__).resolve().parents[3] / "shared" / "data" / "aero_step_16v5_1khz.csv"


def turning(seed: int, rate: float = 500.0):
    """Times, a rotor's speed that wanders between 100 and 400 rad/s, and its angle."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 12.0, 1.0 / rate)
    speed = np.interp(time, np.linspace(0.0, 12.0, 7), rng.uniform(100.0, 400.0, 7))
    return rng, time, speed, np.concatenate(([0.0], np.cumsum(speed[1:]) / rate))


def slow_noise(rng, time, size, tau):
    rho = np.exp(-(time[1] - time[0]) / tau)
    out = rng.standard_normal(time.size)
    for k in range(1, time.size):
        out[k] = rho * out[k - 1] + np.sqrt(1.0 - rho**2) * out[k]
    return size * out


@pytest.mark.parametrize("seed", range(8))
def test_no_ripple_is_found_in_noise(seed):
    rng, time, speed, _ = turning(seed)
    residual = rng.standard_normal(time.size) + (slow_noise(rng, time, 1.0, 0.05) if seed % 2 else 0.0)
    found = find_ripple(time, residual, speed)
    assert found.orders == ()
    assert not found.values.any()


def test_ripple_comes_back_with_its_size_and_leaves_the_noise():
    rng, time, speed, angle = turning(20)
    ripple = 0.5 * np.sin(angle + 0.3) + 1.2 * np.sin(2.0 * angle - 1.0)
    noise = rng.standard_normal(time.size)
    off = 1.0 + 2e-3 * np.sin(time)  # the fitted speed is not quite the true one
    found = find_ripple(time, ripple + noise, speed * off)
    sizes = {o.order: o.amplitude for o in found.orders}
    assert sizes == {1: pytest.approx(0.5, rel=0.15), 2: pytest.approx(1.2, rel=0.1)}
    assert found.noise_with.sd > 1.3
    assert found.noise.sd == pytest.approx(1.0, rel=0.03)
    assert np.std(ripple - found.values) < 0.25


def test_ripple_is_told_from_slow_noise_and_survives_gaps():
    rng, time, speed, angle = turning(21)
    residual = 0.8 * np.cos(2.0 * angle) + 0.5 * rng.standard_normal(time.size) + slow_noise(rng, time, 2.0, 0.2)
    residual[rng.random(time.size) < 0.2] = np.nan
    found = find_ripple(time, residual, speed)
    assert [o.order for o in found.orders] == [2]
    assert found.orders[0].amplitude == pytest.approx(0.8, rel=0.15)
    assert found.noise.sd_white == pytest.approx(0.5, rel=0.1)
    assert found.noise.sd_ou == pytest.approx(2.0, rel=0.4)


def test_a_standing_rotor_has_no_ripple():
    rng, time, _, _ = turning(22)
    assert find_ripple(time, rng.standard_normal(time.size), np.zeros(time.size)).orders == ()


@pytest.mark.skipif(not STEP_RECORDING.exists(), reason="needs the measured recordings in ../shared/data")
def test_measured_current_ripples_twice_a_turn():
    recording = read_recording(STEP_RECORDING)
    part = recording.slice(10.0, 20.0)
    speed = savgol_filter(part.outputs["omega_m"], 501, 2)
    residual = part.outputs["i_m"] - savgol_filter(part.outputs["i_m"], 201, 2)
    found = find_ripple(part.time, residual, speed)
    orders = {o.order: o.amplitude for o in found.orders}
    assert 2 in orders
    assert found.noise.sd < 0.9 * found.noise_with.sd


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return Model.load(export_fmu("Aero.Systems.OneDof", tmp_path_factory.mktemp("fmu") / "OneDof.fmu"))


def test_a_fit_is_freed_of_its_ripple(model):
    rippling = bench.SensorNoise(white=0.005, ripple=(0.004, 0.02))
    sensors = bench.Sensors(rippling, bench.SensorNoise(white=1.0), bench.SensorNoise(white=0.002))
    levels = bench.random_levels(np.random.default_rng(3), 16.0, 8.0)
    recording = bench.simulate_recording(
        bench.Truth("one_dof", bench.Parameters(), (), 0.006), levels, sensors,
        np.random.default_rng(4), duration=8.0, rate_hz=250.0,
    )  # fmt: skip
    fitted = fit(recording, model, settings=FitSettings(method="local", ripple="describe"), workers=0)
    assert fitted.sensors["i_m"]["ripple_subtracted"] is False
    cleaned, report = without_ripple(fitted.calibration.data, fitted.calibration.model, fitted.fitted)
    ripple = report[recording.name]["i_m"]
    assert [o.order for o in ripple.orders][-1] == 2
    assert ripple.noise.sd == pytest.approx(0.005, rel=0.15)
    assert ripple.noise_with.sd > 1.4 * ripple.noise.sd
    assert "omega_m" not in report[recording.name]
    assert np.array_equal(cleaned.measured[0][:, 0], recording.outputs["i_m"] - ripple.values)
    again = fit(recording, model, settings=FitSettings(method="local"), workers=0)
    assert again.sensors["i_m"]["ripple_subtracted"] is True
    assert set(again.sensors) == {"i_m"}
    assert again.to_dict()["sensors"]["i_m"]["ripple"][recording.name]["orders"].keys() == {"1", "2"} & {
        str(o.order) for o in ripple.orders
    }
    assert again.noise["i_m"].sd == pytest.approx(0.005, rel=0.15)
    assert again.calibration.parameters == fitted.calibration.parameters
    # The page draws the readings as they were; with the series of the ripple it comes to the fit's own residual.
    assert ripple_series((recording,), fitted) == {}
    drawn = ripple_series((recording,), again)
    assert set(drawn) == {f"ripple/{recording.name}/i_m"}
    left = recording.outputs["i_m"] - drawn[f"ripple/{recording.name}/i_m"] - again.fitted[0][:, 0]
    np.testing.assert_allclose(left, again.residuals[0][:, 0], atol=1e-12)


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
