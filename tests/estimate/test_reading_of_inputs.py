"""Inputs between their samples: held or in straight lines, each as asked or as the fit finds, against exact answers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from facts import facts
from scipy.signal import cont2discrete, dlsim

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate import CalibrationSettings, ParameterSpec, parameters_from_model
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.interpolation import choose_interpolation, moving_inputs, with_interpolation
from aero_bayes.estimate.objective import Objective
from aero_bayes.simulation.engines import open_simulator
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
TIME, LAG = STEP * np.arange(600), [[-1.0 / TAU]]


def answer(u: np.ndarray, motion: list[list[float]], force: list[list[float]], how: Interpolation, step: float):
    """Of the first state of a linear system at rest to an input that holds, or is linear, between samples."""
    system = (np.array(motion), np.array(force), np.eye(1, len(motion)), np.zeros((1, 1)))
    # the discrete system of straight lines has a state of its own, which starts at rest with the input at zero
    discrete = cont2discrete(system, step, method={"hold": "zoh", "linear": "foh"}[how])
    return dlsim(discrete, u)[1][:, 0]


def house(heater_is: Interpolation, at_night: bool) -> Recording:
    """Outdoors in straight lines; the heater as asked, off at night (most of the day) or always at work."""
    rng = np.random.default_rng(8)
    outside = np.cumsum(rng.standard_normal(TIME.size))
    heater = rng.uniform(0.0, 4.0, TIME.size)
    if at_night:
        heater[(TIME % 24.0 > 9.0)] = 0.0
    outside[0] = heater[0] = 0.0
    room = answer(outside, LAG, [[1.0 / TAU]], "linear", STEP)
    room += answer(heater, LAG, [[GAIN / TAU]], heater_is, STEP)
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


OSCILLATOR = """model Oscillator "A mass on a spring"
  parameter Real m(unit = "s2", min = 0) = 6e-6;
  parameter Real d(unit = "s", min = 0) = 1e-4;
  parameter Real a(unit = "1", min = 0) = 1;
  input Real u(unit = "V");
  output Real y(unit = "V", start = 0);
  Real v(unit = "V/s", start = 0);
equation
  der(y) = v;
  m*der(v) = u - d*v - a*y;
end Oscillator;
"""
MASS, DAMPING, SPRING = 5.1e-6, 2.2e-4, 0.97


def resonating() -> Recording:
    """A resonance that shows at the samples as one ten times as fast, where the inputs are read as held."""
    rng = np.random.default_rng(91)
    time, tones = np.arange(3000) / 610.0, np.arange(1, 200)
    phases = rng.uniform(0.0, 2.0 * np.pi, tones.size)
    u = 0.012 * np.sin(2.0 * np.pi * np.outer(time, tones) + phases).sum(axis=1)
    motion, force = [[0.0, 1.0], [-SPRING / MASS, -DAMPING / MASS]], [[0.0], [1.0 / MASS]]
    y = answer(u, motion, force, "linear", 1.0 / 610.0)[1000:] + 1e-3 * rng.standard_normal(2000)
    return Recording("run", time[1000:] - time[1000], {"u": u[1000:]}, {"y": y})


def test_a_resonance_is_not_taken_for_its_alias(exported):
    """Held inputs make the alias the better of two bad fits; straight lines are tried from the start as well."""
    model = exported(OSCILLATOR)
    free = parameters_from_model(model, overrides={name: ParameterSpec() for name in ("m", "d", "a")})
    held = calibrate([resonating()], model, free, settings=CalibrationSettings(initial_states="estimated"))
    with open_simulator(held.problem(), workers=0) as simulator:
        search = GlobalSearch(Objective(held, simulator), aero_bayes.FitSettings(method="local"))
        columns = tuple(range(len(held.parameters)))
        there = held.parameters.start.copy()
        there[:3] = [MASS / 79.0, DAMPING / 79.0, SPRING]
        alias, near = (
            search.refit(held.parameters.to_search(at), columns, search.initial_noise())
            for at in (there, held.parameters.start)
        )
        assert alias.log_likelihood > near.log_likelihood + 100.0
        found = choose_interpolation(search, alias, partial(open_simulator, workers=0), np.random.default_rng(1))
    assert found is not None
    calibration, optimum = found
    assert calibration.data.interpolation == {"u": "linear"}
    mass, damping, spring = calibration.parameters.from_search(optimum.coordinates)[:3]
    assert mass == pytest.approx(MASS, rel=0.01)
    assert damping == pytest.approx(DAMPING, rel=0.05)
    assert spring == pytest.approx(SPRING, rel=0.01)
