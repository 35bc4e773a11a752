"""A cheap problem leads to the valley of the full one, and the beginning of a recording to that of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import FormulaSimulator, calibration, parameter
from scipy.signal import cont2discrete

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, NoiseModel, ParameterSpec, Uniform, parameters_from_model
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.delays import with_few_samples
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.simulation.engines import open_simulator

PENDULUM = """
model Swinging "A lightly damped oscillator under a force"
  parameter Real w(min = 0.5, max = 20) = 2 "Angular frequency";
  input Real u;
  output Real x = s;
  Real s(start = 3, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(s) = v;
  der(v) = u - w * w * s - 0.05 * v;
end Swinging;
"""


def swinging(w, force, interval):
    """Exact position (n,) of the oscillator under a force (n,) that is held between samples."""
    system = np.array([[0.0, 1.0], [-w * w, -0.05]]), np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))
    ad, bd, *_ = cont2discrete(system, interval)
    out = [np.array([3.0, 0.0])]
    for u in force[:-1]:
        out.append(ad @ out[-1] + bd[:, 0] * u)
    return np.array(out)[:, 0]


def of_pendulum(model, force, readings):
    free = parameters_from_model(model, overrides={"w": ParameterSpec()})
    settings = CalibrationSettings(delay="none", may_start_at_rest=())
    return calibrate([Recording("swing", TIME, {"u": force}, {"x": readings})], model, free, settings=settings)


SAMPLES, INTERVAL = 150, 0.02
TIME = np.arange(3000) * INTERVAL
#: Name: frequency, a force that changes at every sample, whether its averages will do.
FORCES = {
    "slow": (1.5, sum(np.sin(f * TIME + f) for f in (0.3, 0.8, 1.1)), True),
    "rough": (8.0, 60.0 * np.sign(np.sin(1e3 * TIME**2 + 0.5)) * (1.0 + 0.1 * np.cos(TIME)), False),
}


@pytest.mark.parametrize("kind", FORCES)
def test_the_cheap_problem_leads_to_the_valley_of_the_full_one(exported, kind):
    w, force, averaged = FORCES[kind]
    readings = swinging(w, force, INTERVAL) + 0.02 * np.random.default_rng(3).standard_normal(TIME.size)
    calibration = of_pendulum(exported(PENDULUM), force, readings)
    assert np.all(np.diff(force) != 0.0)

    with open_simulator(calibration.problem(), workers=0) as simulator:
        cheap = with_few_samples(calibration, simulator, SAMPLES)
        (full,), (few,) = calibration.data.experiments, cheap.data.experiments
        assert bool(few.time[-1] > 0.9 * TIME[-1]) is averaged
        assert few.time.size <= 3 * SAMPLES
        # What a simulation costs is the number of times at which its input jumps.
        assert few.inputs[0].time.size <= 0.2 * full.inputs[0].time.size

        grid = np.geomspace(0.55, 18.0, 400)
        with open_simulator(cheap.problem(), workers=0) as small:
            residuals = Objective(cheap, small).residuals(cheap.parameters.to_search(grid[:, None]))
        costs = np.array([float(r.residual[0] @ r.residual[0]) for r in residuals])
        valleys = np.flatnonzero((costs[1:-1] < costs[:-2]) & (costs[1:-1] < costs[2:])) + 1
        assert valleys.size > 3

        objective = Objective(calibration, simulator)
        white = LocalFitSettings(kinds={"x": "white"})
        ends = [
            calibration.parameters.from_search(
                local_fit(objective, calibration.parameters.to_search(grid[[k]]), (0,), settings=white).coordinates
            )[0]
            for k in valleys[np.argsort(costs[valleys])[:3]]
        ]
    assert ends[0] == pytest.approx(w, rel=1e-3)
    assert all(abs(end / w - 1.0) > 1e-2 for end in ends[1:])


def test_few_changes_of_the_input_are_left_as_they_are(exported):
    calibration = of_pendulum(exported(PENDULUM), np.repeat([1.0, -1.0, 2.0], 1000), np.cos(TIME))
    with open_simulator(calibration.problem(), workers=0) as simulator:
        cheap = with_few_samples(calibration, simulator, SAMPLES)
    assert cheap.data.experiments[0].inputs == calibration.data.experiments[0].inputs
    assert cheap.data.experiments[0].time.size == SAMPLES


def test_a_wave_of_many_periods_is_found_from_its_beginning():
    """In the whole recording the valley is a thirtieth as wide as the start is off; in its first period it is not."""
    t = np.linspace(0.0, 40.0, 600)

    def wave(t, v):
        return (v[0] * np.sin(v[1] * t))[:, None]

    rng = np.random.default_rng(7)
    bounds = {"a": (0.7, 0.0, 4.0), "w": (3.0, 0.2, 9.0)}
    items = [parameter(n, s, low, high, Uniform(low, high)) for n, (s, low, high) in bounds.items()]
    y = wave(t, np.array([1.0, 3.7])) + 0.05 * rng.normal(size=(600, 1))
    problem = calibration([(t, y)], ["y"], items, NoiseModel())

    def found(settings):
        opened = lambda asked: FormulaSimulator(asked, wave)  # noqa: E731
        return fit_calibration(problem, opened, settings, np.random.default_rng(1)).values[1]

    assert abs(found(FitSettings(pso=None)) - 3.7) > 0.1
    assert found(FitSettings(pso=SwarmSettings(particles=2, iterations=1))) == pytest.approx(3.7, abs=0.01)


def test_a_start_is_not_called_as_a_parameter_of_the_model(exported):
    """Blocks have a parameter ``y_start`` beside their state ``y``."""
    model = exported(
        'model Lag\n  parameter Real T(unit = "s") = 2;\n  parameter Real y_start = 0.5;\n  input Real u;\n'
        "  output Real y(start = y_start, fixed = true);\nequation\n  T * der(y) = u - y;\nend Lag;\n"
    )
    time = np.arange(200) * 0.05
    y = 1.0 - 0.7 * np.exp(-time / 2.0) + 0.002 * np.random.default_rng(3).standard_normal(time.size)
    free = parameters_from_model(model, overrides={"T": ParameterSpec(), "y_start": ParameterSpec()})
    settings = CalibrationSettings(delay="none", initial_states="estimated")
    made = calibrate([Recording("step", time, {"u": np.ones(time.size)}, {"y": y})], model, free, settings=settings)
    assert made.parameters.names == ("T", "y_start")  # searched as the initial value that it is
    held = calibrate([made.data.recordings[0]], model, free.without(["y_start"]), settings=settings)
    assert held.parameters.names == ("T", "y_initial")
