"""Inputs between their samples: held or in straight lines, each as asked or as the fit finds, against exact answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from facts import facts
from scipy.signal import cont2discrete, dlsim

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate import CalibrationSettings, ParameterSpec, parameters_from_model
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.interpolation import moving_inputs, with_interpolation
from aero_bayes.simulation.interface import Interpolation

HOUSE = """model House "A room with a heater"
  parameter Real tau(unit = "h", min = 0.1, max = 100) = 3 "Time constant";
  parameter Real gain(unit = "K/kW", min = 0.1, max = 100) = 3 "Of the heater";
  input Real T_amb(unit = "K");
  input Real heater(unit = "kW");
  output Real T(unit = "K", start = 0, fixed = true);
equation
  tau * der(T) = T_amb - T + gain * heater;
end House;
"""
TAU, GAIN, STEP, NOISE = 2.0, 5.0, 0.5, 0.02
TIME = STEP * np.arange(600)


def answer(u: np.ndarray, gain: float, how: Interpolation) -> np.ndarray:
    """Of the room at its samples to an input that holds or runs in straight lines between them."""
    method = {"hold": "zoh", "linear": "foh"}[how]
    one = np.ones((1, 1))
    system = cont2discrete((-one / TAU, gain * one / TAU, one, 0.0 * one), STEP, method=method)
    # the discrete system of straight lines has a state of its own, which starts at rest with the input at zero
    return dlsim(system, u)[1][:, 0]


def house(heater_is: Interpolation, at_night: bool) -> Recording:
    """Outdoors in straight lines; the heater as asked, off at night (most of the day) or always at work."""
    rng = np.random.default_rng(8)
    outside = np.cumsum(rng.standard_normal(TIME.size))
    heater = rng.uniform(0.0, 4.0, TIME.size)
    if at_night:
        heater[(TIME % 24.0 > 9.0)] = 0.0
    outside[0] = heater[0] = 0.0
    room = answer(outside, 1.0, "linear") + answer(heater, GAIN, heater_is)
    return Recording(
        "house", TIME, {"T_amb": outside, "heater": heater}, {"T": room + NOISE * rng.standard_normal(TIME.size)}
    )


def fitted(exported, recording: Recording, interpolation) -> aero_bayes.Fit:
    model = exported(HOUSE)
    settings = aero_bayes.FitSettings(
        method="local", calibration=CalibrationSettings(initial_states="reading", interpolation=interpolation)
    )
    free = parameters_from_model(model, overrides={name: ParameterSpec() for name in ("tau", "gain")})
    return aero_bayes.fit(recording, model, parameters=free, settings=settings, workers=0)


@pytest.mark.parametrize("at_night", [True, False])
def test_straight_lines_that_are_asked_for_are_every_inputs(exported, at_night: bool) -> None:
    recording = house("linear", at_night)
    assert (np.mean(np.diff(recording.inputs["heater"]) != 0.0) < 0.5) == at_night
    fit = fitted(exported, recording, "linear")
    assert fit.to_dict()["fit"]["interpolation"] == {"T_amb": "linear", "heater": "linear"}
    assert fit.rms["T"] == pytest.approx(NOISE, rel=0.1)
    np.testing.assert_allclose(fit.simulate(recording).outputs["T"], recording.outputs["T"], atol=5.0 * NOISE)


@pytest.mark.parametrize("heater_is", ["hold", "linear"])
@pytest.mark.parametrize("at_night", [True, False])
def test_the_fit_decides_for_each_input(exported, heater_is: Interpolation, at_night: bool) -> None:
    fit = fitted(exported, house(heater_is, at_night), "auto")
    assert fit.to_dict()["fit"]["interpolation"] == {"T_amb": "linear", "heater": heater_is}
    assert fit.rms["T"] == pytest.approx(NOISE, rel=0.1)
    assert fit["gain"].value == pytest.approx(GAIN, rel=0.01)


def test_a_reading_by_name_and_what_may_move(exported) -> None:
    recording = house("hold", at_night=True)
    steps = np.repeat(np.arange(60.0), 10)
    recording = Recording("house", TIME, {**recording.inputs, "heater": steps}, recording.outputs)
    model = exported(HOUSE)
    free = parameters_from_model(model, overrides={"tau": ParameterSpec()})
    settings = CalibrationSettings(initial_states="reading", interpolation={"T_amb": "linear"})
    calibration = calibrate([recording], model, free, settings=settings)
    assert calibration.data.interpolation == {"T_amb": "linear", "heater": "hold"}
    assert moving_inputs(calibration.data.recordings[0], model) == ("T_amb",)
    back = with_interpolation(with_interpolation(calibration, {"heater": "linear"}), {"heater": "hold"})
    for one, other in zip(calibration.data.experiments[0].inputs, back.data.experiments[0].inputs, strict=True):
        assert (one.name, one.interpolation) == (other.name, other.interpolation)
        np.testing.assert_array_equal(np.stack([one.time, one.values]), np.stack([other.time, other.values]))
    discrete = replace(model, inputs=tuple(replace(variable, discrete=True) for variable in model.inputs))
    assert moving_inputs(calibration.data.recordings[0], discrete) == ()
    with pytest.raises(InputError, match=facts("interpolation", "wind", "house", "T_amb", "heater")):
        calibrate([recording], model, free, settings=CalibrationSettings(interpolation={"wind": "linear"}))
