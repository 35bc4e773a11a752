"""A model that is wrong is fitted as well as it can be, and says that it is wrong; so does a bound that is too near."""

from __future__ import annotations

import json

import closed_form
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lsim

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, LogUniform, ParameterSpec, Uniform, parameters_from_model
from aero_bayes.estimate.fit import fit, fit_calibration
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.simulation.model import Model

LINEAR_SPRING = """
model LinearSpring "A driven mass on a spring that is taken for linear"
  parameter Real k(min = 1, max = 100) = 12 "Stiffness per mass";
  parameter Real d(min = 0.01, max = 10) = 0.5 "Damping per mass";
  input Real u;
  output Real x = s;
  Real s(start = 0, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(s) = v;
  der(v) = u - k * s - d * v;
end LinearSpring;
"""
TIME = np.arange(0.0, 30.0, 0.02)
LEVELS = np.repeat([3.0, -2.0, 6.0, 0.0, -5.0, 2.0, 7.0, -7.0, 1.0, 4.0], 150)
NOISE = 5e-3
HELD_STARTS = CalibrationSettings(delay="none", may_start_at_rest=())


def linear(k: float, d: float) -> np.ndarray:
    """Position of the driven mass on a linear spring, exact for a force that is held between samples."""
    system = [[0.0, 1.0], [-k, -d]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]
    return lsim(system, LEVELS, TIME, interp=False)[1]


def hardening(k: float, d: float, cubic: float) -> np.ndarray:
    """The same on a spring that hardens, by Runge-Kutta steps."""

    def slope(z: np.ndarray, u: float) -> np.ndarray:
        return np.array([z[1], u - k * z[0] - cubic * z[0] ** 3 - d * z[1]])

    return closed_form.held(slope, np.zeros(2), LEVELS, 0.02, 4)[:, 0]


def fitted_spring(model: Model, readings: np.ndarray, settings: FitSettings) -> Fit:
    parameters = parameters_from_model(model, overrides={"k": ParameterSpec(), "d": ParameterSpec()})
    recording = Recording("spring", TIME, {"u": LEVELS}, {"x": readings})
    return fit(recording, model, parameters=parameters, settings=settings, workers=0)


@pytest.fixture(scope="module")
def wrong(exported):
    """The default fit of a linear spring to a hardening one, and the readings."""
    readings = hardening(10.0, 0.6, 12.0) + NOISE * np.random.default_rng(4).standard_normal(TIME.size)
    settings = FitSettings(pso=SwarmSettings(particles=16, iterations=30), calibration=HELD_STARTS)
    return fitted_spring(exported(LINEAR_SPRING), readings, settings), readings


def test_a_wrong_model_follows_the_data_as_least_squares_does(wrong):
    found, readings = wrong
    least = min(
        (least_squares(lambda p: linear(*p) - readings, start, bounds=([1.0, 0.01], [100.0, 10.0])) for start in
         ([found["k"].value, found["d"].value], [14.0, 0.6])),
        key=lambda r: r.cost,
    )  # fmt: skip
    squares = np.sqrt(np.mean(least.fun**2))
    assert squares > 10.0 * NOISE
    # An error that is held weighs as least squares does, so that hardly anything is allowed but the solvers' error.
    assert squares * (1.0 - 1e-3) < found.rms["x"] < 1.005 * squares


def test_a_wrong_model_says_so_and_widens_its_intervals(wrong):
    found, _ = wrong
    assert found.noise["x"].model_error
    assert any("does not explain x" in line for line in found.warnings)
    assert any("does not explain x" in line for line in json.loads(json.dumps(found.to_dict()))["warnings"])
    white = found.optimum.whitened.slopes @ found.optimum.whitened.slopes.T
    plain = np.sqrt(np.diag(np.linalg.inv(white)))
    assert np.all(found.laplace.sd[:2] > 1.2 * plain)


def test_the_right_model_says_nothing(exported):
    readings = linear(10.0, 0.6) + NOISE * np.random.default_rng(5).standard_normal(TIME.size)
    found = fitted_spring(exported(LINEAR_SPRING), readings, FitSettings("local", calibration=HELD_STARTS))
    assert found.warnings == ()
    assert found.widening is None
    for name, truth in (("k", 10.0), ("d", 0.6)):
        assert abs(found[name].value - truth) < 4.5 * found[name].sd


def test_a_parameter_that_ends_on_its_bound_has_no_interval():
    def decay(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (v[0] * np.exp(-v[1] * t))[:, None]

    time = np.linspace(0.0, 4.0, 200)
    y = decay(time, np.array([2.0, 1.5])) + 0.02 * np.random.default_rng(6).standard_normal((time.size, 1))
    items = [
        closed_form.parameter("A", 1.0, 0.1, 9.0, Uniform(0.1, 9.0)),
        closed_form.parameter("r", 0.5, 0.1, 1.2, LogUniform(0.1, 1.2), "log"),
    ]
    problem = closed_form.calibration([(time, y)], ["y"], items)
    found = fit_calibration(
        problem, lambda p: closed_form.FormulaSimulator(p, decay), FitSettings(pso=SwarmSettings(16, 30))
    )
    estimate, inside = found["r"], found["A"]
    assert estimate.value == pytest.approx(1.2, rel=1e-6)
    assert estimate.status is Status.AT_BOUND
    assert (estimate.sd, estimate.q05, estimate.q50, estimate.q95) == (None,) * 4
    assert "bound" in estimate.note
    assert inside.status is Status.IDENTIFIED
    assert inside.sd is not None
    told = json.loads(json.dumps(found.to_dict()))["parameters"]["r"]
    assert (told["status"], told["sd"], told["q05"], told["q95"]) == ("at_bound", None, None, None)
