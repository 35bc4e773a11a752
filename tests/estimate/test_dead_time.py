"""A dead time of one input that is many samples long, found exactly; the other input has none."""

from __future__ import annotations

import numpy as np
import pytest
from facts import facts

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate import CalibrationSettings, ParameterSpec, parameters_from_model

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
TAU, GAIN, DEAD, NOISE, STEP = 7200.0, 0.01, 907.0, 0.03, 60.0
TIME = STEP * np.arange(1500)


def room(seed: int) -> Recording:
    """Exact from jump to jump: outdoors new every hour, the heater on or off for a while, felt a dead time later."""
    rng = np.random.default_rng(seed)
    outside = np.repeat(rng.normal(0.0, 2.0, 25), 60)
    heater = np.repeat(np.where(rng.random(50) < 0.5, 1500.0, 0.0), 30)
    heater[0] = 0.0
    jumps = np.unique(np.concatenate([TIME, TIME + DEAD]))
    level = np.zeros(jumps.size)
    for n in range(jumps.size - 1):
        now = np.searchsorted(TIME, jumps[n], side="right") - 1
        late = np.searchsorted(TIME, jumps[n] - DEAD, side="right") - 1
        end = outside[min(now, TIME.size - 1)] + GAIN * (heater[late] if late >= 0 else heater[0])
        level[n + 1] = end + (level[n] - end) * np.exp(-(jumps[n + 1] - jumps[n]) / TAU)
    read = level[np.searchsorted(jumps, TIME)] + NOISE * rng.standard_normal(TIME.size)
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
