"""A resonance that shows at the samples as one ten times as fast, where the inputs are read as held.

The record is an oscillator's exact answer to an input that moves in straight lines, by the matrix exponential.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, ParameterSpec, parameters_from_model
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.interpolation import choose_interpolation
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.objective import Objective
from aero_bayes.simulation.engines import open_simulator

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
MASS, DAMPING, SPRING, STEP, NOISE = 5.1e-6, 2.2e-4, 0.97, 1.0 / 610.0, 1e-3


def record() -> Recording:
    rng = np.random.default_rng(91)
    time = STEP * np.arange(3000)
    tones = np.arange(1, 200)
    phases = rng.uniform(0.0, 2.0 * np.pi, tones.size)
    u = 0.012 * np.sin(2.0 * np.pi * np.outer(time, tones) + phases).sum(axis=1)
    motion, force = np.array([[0.0, 1.0], [-SPRING / MASS, -DAMPING / MASS]]), np.array([[0.0], [1.0 / MASS]])
    system = cont2discrete((motion, force, np.array([[1.0, 0.0]]), np.zeros((1, 1))), STEP, method="foh")
    _, y, _ = dlsim(system, u)
    keep = slice(1000, None)
    y = y[keep, 0] + NOISE * rng.standard_normal(time[keep].size)
    return Recording("run", time[keep] - time[1000], {"u": u[keep]}, {"y": y})


def test_a_resonance_is_not_taken_for_its_alias(exported):
    """Held inputs make the alias the better of two bad fits; straight lines are tried from the start as well."""
    model = exported(OSCILLATOR)
    free = parameters_from_model(model, overrides={name: ParameterSpec() for name in ("m", "d", "a")})
    held = calibrate([record()], model, free, settings=CalibrationSettings(initial_states="estimated"))
    with open_simulator(held.problem(), workers=0) as simulator:
        search = GlobalSearch(Objective(held, simulator), FitSettings(method="local"))
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
