"""A dead time of many samples of one input, and delays whose likelihood has a valley between every two samples.

The fit must end in the valley that holds the truth.
"""

from __future__ import annotations

import numpy as np
import pytest
from facts import facts
from scipy.signal import lfilter

import aero_bayes
import simulated_rigs.aero as bench
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate import CalibrationSettings, ParameterSpec, parameters_from_model
from aero_bayes.estimate.delays import laplace_log_evidence
from aero_bayes.estimate.levenberg_marquardt import LocalResult, QuadraticModel, Stop
from simulated_rigs.kinds import AERO

ROOM = """model Room "A room with a heater"
  parameter Real tau(unit = "s", min = 100, max = 1e6) = 5000 "Time constant";
  parameter Real gain(unit = "K/W", min = 1e-4, max = 1) = 0.02 "Of the heater";
  input Real T_amb(unit = "K");
  input Real heater(unit = "W");
  output Real T(unit = "K", start = 0, fixed = true);
equation
  tau * der(T) = T_amb - T + gain * heater;
end Room;
"""
TAU, GAIN, DEAD, NOISE, STEP = 7200.0, 0.01, 907, 0.03, 60.0
TIME = STEP * np.arange(1500)


def room(seed: int) -> Recording:
    """Exact from second to second: outdoors new every hour; the heater on or off, felt a dead time later."""
    rng = np.random.default_rng(seed)
    outside = np.repeat(rng.normal(0.0, 2.0, 25), 60)
    heater = np.repeat(np.where(rng.random(50) < 0.5, 1500.0, 0.0), 30)
    heater[0] = 0.0
    seconds, decay = np.arange(int(TIME[-1]) + 1), np.exp(-1.0 / TAU)
    drive = np.repeat(outside, 60)[seconds] + GAIN * np.repeat(heater, 60)[np.maximum(seconds - DEAD, 0)]
    read = lfilter([0.0, 1.0 - decay], [1.0, -decay], drive)[::60] + NOISE * rng.standard_normal(TIME.size)
    return Recording(f"room{seed}", TIME, {"T_amb": outside, "heater": heater}, {"T": read})


def fitted(exported, recordings, limit) -> aero_bayes.Fit:
    model = exported(ROOM)
    settings = aero_bayes.FitSettings(
        method="local", calibration=CalibrationSettings(initial_states="reading", max_input_delay=limit)
    )
    free = parameters_from_model(model, overrides={name: ParameterSpec() for name in ("tau", "gain")})
    return aero_bayes.fit(recordings, model, parameters=free, settings=settings, workers=0)


def test_a_dead_time_of_many_samples_is_its_inputs_alone(exported) -> None:
    fit = fitted(exported, [room(1), room(2)], {"heater": 1800.0})
    assert set(fit.parameters) >= {"tau", "gain", "heater_delay"}
    delay = fit["heater_delay"]
    assert delay.value == pytest.approx(DEAD, abs=4.0 * delay.sd)
    assert delay.sd < 5.0
    assert fit["tau"].value == pytest.approx(TAU, rel=0.01)
    assert fit.rms["T"] == pytest.approx(NOISE, rel=0.05)
    together = fitted(exported, [room(1), room(2)], 1800.0)
    assert together.rms["T"] > 2.0 * NOISE


def test_a_delay_of_an_input_that_was_not_recorded_is_refused(exported) -> None:
    with pytest.raises(InputError, match=facts("delay", "wind", "room1", "T_amb", "heater")):
        fitted(exported, room(1), {"wind": 10.0})


@pytest.mark.parametrize("seed", [1, 2])
def test_the_narrow_valley_of_a_delay_is_found(one_dof, seed: int) -> None:
    """The reading 0.1 ms after a jump sees the current on its way; from the wide valley R_a would end 5 sd off."""
    truth, late = {"R_a": 9.9, "J_r": 9e-6}, 0.0099
    rng = np.random.default_rng(seed)
    recording = bench.simulate_recording(
        bench.Truth((), late, {**AERO.parameters, **truth}),
        bench.random_levels(rng, 24.0, 8.0, (0.3, 2.5), 0.5), bench.white(15.0), rng, duration=8.0, rate_hz=100.0,
    )  # fmt: skip
    settings = aero_bayes.FitSettings(method="local", calibration=CalibrationSettings(delay="free"))
    found = aero_bayes.fit(recording, one_dof, settings=settings, workers=0).parameters
    for name, value in {**truth, "input_delay": late}.items():
        assert abs(found[name].value - value) < 4.5 * found[name].sd


def test_a_needle_holds_less_than_a_valley() -> None:
    def end(cost, curvature):
        return LocalResult(np.zeros(2), QuadraticModel(cost, np.zeros(2), curvature), 3, Stop.CONVERGED, 1)

    needle, valley = end(0.0, np.diag([1e12, 1.0])), end(4.0, np.diag([1e4, 1.0]))
    assert laplace_log_evidence(valley) - laplace_log_evidence(needle) == pytest.approx(0.5 * np.log(1e8) - 4.0)
    assert laplace_log_evidence(LocalResult(np.zeros(2), None, 0, Stop.FAILED_START, 1)) == -np.inf
