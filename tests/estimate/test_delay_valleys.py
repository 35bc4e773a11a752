"""A delay's likelihood has a valley between every two samples; the fit must end in the one that holds the truth."""

import numpy as np
import pytest

import simulated_rigs.aero as bench
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.delays import laplace_log_evidence
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.levenberg_marquardt import FitSettings, LocalResult, QuadraticModel, Stop
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.model import Model
from simulated_rigs.kinds import AERO


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return Model.load(export_fmu("Aero.Systems.OneDof", tmp_path_factory.mktemp("fmu") / "OneDof.fmu"))


@pytest.mark.parametrize("seed", [1, 2])
def test_the_narrow_valley_of_a_delay_is_found(model, seed):
    """The reading 0.1 ms after a jump sees the current on its way; from the wide valley R_a would end 5 sd off."""
    truth, late = {"R_a": 9.9, "J_r": 9e-6}, 0.0099
    rng = np.random.default_rng(seed)
    recording = bench.simulate_recording(
        bench.Truth((), late, {**AERO.parameters, **truth}),
        bench.random_levels(rng, 24.0, 8.0, (0.3, 2.5), 0.5), bench.white(15.0), rng, duration=8.0, rate_hz=100.0,
    )  # fmt: skip
    settings = FitSettings(method="local", calibration=CalibrationSettings(delay="free"))
    found = fit(recording, model, settings=settings, workers=0).parameters
    for name, value in {**truth, "input_delay": late}.items():
        assert abs(found[name].value - value) < 4.5 * found[name].sd


def test_delays_of_two_recordings_are_found_apart(model):
    rng = np.random.default_rng(6)
    delays = {"a": 0.00991, "b": 0.0117}
    recordings = [
        bench.simulate_recording(
            bench.Truth((), late), bench.random_levels(rng, 24.0, 8.0, (0.3, 2.5), 0.5),
            bench.white(1.0), rng, duration=8.0, rate_hz=100.0, name=name,
        )
        for name, late in delays.items()
    ]  # fmt: skip
    settings = FitSettings(method="local", calibration=CalibrationSettings(delay="free"))
    found = fit(recordings, model, settings=settings, workers=0).parameters
    for name, late in delays.items():
        estimate = found[f"input_delay[{name}]"]
        assert abs(estimate.value - late) < 4.5 * estimate.sd


def test_a_needle_holds_less_than_a_valley():
    def end(cost, curvature):
        return LocalResult(np.zeros(2), QuadraticModel(cost, np.zeros(2), curvature), 3, Stop.CONVERGED, 1)

    needle, valley = end(0.0, np.diag([1e12, 1.0])), end(4.0, np.diag([1e4, 1.0]))
    assert laplace_log_evidence(valley) - laplace_log_evidence(needle) == pytest.approx(0.5 * np.log(1e8) - 4.0)
    assert laplace_log_evidence(LocalResult(np.zeros(2), None, 0, Stop.FAILED_START, 1)) == -np.inf
