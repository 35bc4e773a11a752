"""Slopes that are zero, infinite, or jump: parameters that select a branch, one under a root, a model that switches."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from closed_form import square_wave_lag
from numpy.random import Generator

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


@pytest.mark.parametrize(("gain", "low", "high"), [(1.0, 0.1, 1.0), (3.0, 1.0, 3.0)])
def test_value_of_the_search_is_kept(
    exported: Callable[[str], Model], rng: Generator, gain: float, low: float, high: float
):
    model, recording = exported(BRANCH), square_wave_lag(rng, gain)
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


def test_nothing_better_was_seen_than_what_is_reported(exported: Callable[[str], Model], rng: Generator):
    model, recording = exported(BRANCH), square_wave_lag(rng, 1.0)
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


def test_loop_searches_it_too(exported: Callable[[str], Model], rng: Generator, tmp_path):
    model, recording = exported(BRANCH), square_wave_lag(rng, 1.0)
    settings = aero_bayes.LoopSettings(
        parameters=("limit", "tau"), fit=FitSettings(method="local", calibration=START_AT_READING)
    )
    loop = aero_bayes.close_loop([recording], model=str(model.path), settings=settings, workers=0, out_dir=tmp_path)
    assert loop.outcome == "adequate"
    assert loop["tau"].value == pytest.approx(4.0, rel=0.03)


ROOT = """model Root
  parameter Real a(min = 0, max = 1) = 0.3;
  parameter Real tau(unit = "s", min = 0.1, max = 100) = 1.5;
  input Real u;
  output Real y(start = 0, fixed = true);
equation
  tau * der(y) = u + sqrt(a) * sqrt(abs(y)) - y;
end Root;
"""


@pytest.mark.parametrize("truth", [0.0, 1e-9])
def test_a_root_of_a_parameter_that_is_zero(exported: Callable[[str], aero_bayes.Model], truth: float) -> None:
    given = square_wave_lag(np.random.default_rng(1))
    recording = replace(given, outputs={"y": given.outputs["y"] + np.sqrt(truth)})
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = aero_bayes.fit(recording, exported(ROOT), parameters=["a", "tau"], workers=0)
    assert found["tau"].value == pytest.approx(4.0, rel=0.03)
    assert found["a"].value < 1e-2
    assert np.isfinite(found.covariance).all()


BALL = """model Ball
  parameter Real g(unit = "m/s2", min = 1, max = 30) = 9.5;
  parameter Real e(min = 0.1, max = 0.99) = 0.8;
  output Real h(unit = "m", start = 1, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(h) = v;
  der(v) = -g;
  when h < 0 then
    reinit(v, -e * pre(v));
  end when;
end Ball;
"""
G, E, SD = 9.81, 0.85, 0.005


def ball(time: np.ndarray) -> np.ndarray:
    """Parabolas between the bounces."""
    found, begin, speed, height = np.empty_like(time), 0.0, 0.0, 1.0
    for _ in range(40):
        flight = (speed + np.sqrt(speed**2 + 2.0 * G * height)) / G
        now = (time >= begin) & (time < begin + flight)
        since = time[now] - begin
        found[now] = height + speed * since - 0.5 * G * since**2
        begin, speed, height = begin + flight, E * (G * flight - speed), 0.0
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_interval_leaves_the_truth_out(exported: Callable[[str], Model], seed: int) -> None:
    time = np.linspace(0.0, 2.5, 501)
    readings = ball(time) + SD * np.random.default_rng(seed).standard_normal(time.size)
    recording, settings = Recording("run", time, {}, {"h": readings}), FitSettings("local")
    fit = aero_bayes.fit(recording, exported(BALL), parameters=["g", "e"], settings=settings, seed=seed, workers=0)
    assert fit.rms["h"] == pytest.approx(SD, rel=0.2)
    for name, true in (("g", G), ("e", E)):
        assert fit[name].value == pytest.approx(true, rel=0.02)
        if fit[name].sd is not None:
            assert abs(fit[name].value - true) < 4.5 * fit[name].sd
