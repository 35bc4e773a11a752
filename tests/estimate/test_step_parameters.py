"""A parameter that selects a branch has no slope: what the search found for it is what is reported."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from closed_form import square_wave_lag

import aero_bayes
from aero_bayes import FitSettings, Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.global_search import MAX_SEEN_GAIN, GlobalSearch
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import parameters_from_model
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.model import Model

BRANCH = """
model Branch
  parameter Real limit(min = 0.1, max = 3) = 2;
  parameter Real tau(unit = "s", min = 0.1, max = 100) = 1;
  parameter Real idle(min = 0, max = 10) = 3;
  input Real u;
  output Real y(start = 0, fixed = true);
equation
  tau * der(y) = (if limit < 1 then 1 else 3) * u - y;
end Branch;
"""
START_AT_READING = CalibrationSettings(initial_states="reading")


def stepped(rng: np.random.Generator, gain: float) -> Recording:
    """Response of a first-order lag of 4 s to a square wave, in closed form, with noise of 0.01."""
    time, u, y = square_wave_lag(gain)
    return Recording("run", time, {"u": u}, {"y": y + 0.01 * rng.standard_normal(time.size)}, {})


@pytest.mark.parametrize(("gain", "low", "high"), [(1.0, 0.1, 1.0), (3.0, 1.0, 3.0)])
def test_value_of_the_search_is_kept(
    exported: Callable[[str], Model], rng: np.random.Generator, gain: float, low: float, high: float
):
    model, recording = exported(BRANCH), stepped(rng, gain)
    settings = FitSettings(calibration=START_AT_READING)
    fit = aero_bayes.fit(recording, model, parameters=["limit", "tau", "idle"], settings=settings, workers=0)
    assert low <= fit["limit"].value <= high
    assert fit["tau"].value == pytest.approx(4.0, rel=0.03)
    assert fit.rms["y"] < 0.012
    assert fit["idle"].value == 3.0
    assert fit.unidentified[-1] == "idle"
    steps = fit.identifiability.in_steps
    if gain == 1.0:  # where the start is in the right branch there is nothing to keep
        assert steps["limit"].lower == pytest.approx(0.1)
        assert steps["limit"].upper == pytest.approx(1.0, rel=0.01)


def test_nothing_better_was_seen_than_what_is_reported(exported: Callable[[str], Model], rng: np.random.Generator):
    model, recording = exported(BRANCH), stepped(rng, 1.0)
    calibration = calibrate(
        [recording], model, parameters_from_model(model, ["limit", "tau"]), settings=START_AT_READING
    )
    with open_simulator(calibration.problem(), workers=0) as simulator:
        search = GlobalSearch(Objective(calibration, simulator), FitSettings())
        found = search.run((0, 1), lambda problem: open_simulator(problem, workers=0), rng)
        gains = search.seen_gains(found)
    assert gains.size > 3
    assert gains.max() <= MAX_SEEN_GAIN
    fit = fit_calibration(calibration, lambda problem: open_simulator(problem, workers=0))
    assert fit.log_likelihood >= found.log_likelihood - 1.0


def test_loop_searches_it_too(exported: Callable[[str], Model], rng: np.random.Generator, tmp_path):
    model, recording = exported(BRANCH), stepped(rng, 1.0)
    settings = aero_bayes.LoopSettings(
        parameters=("limit", "tau"), fit=FitSettings(method="local", calibration=START_AT_READING)
    )
    loop = aero_bayes.close_loop([recording], model=str(model.path), settings=settings, workers=0, out_dir=tmp_path)
    assert loop.outcome == "adequate"
    assert loop["tau"].value == pytest.approx(4.0, rel=0.03)
