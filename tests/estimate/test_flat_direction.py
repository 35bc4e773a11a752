"""A drive whose current is not recorded: no scale of its torques, and a held friction that pretends to give one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import aero_bayes
from aero_bayes import FitSettings, Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.identifiability import assess
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.words import verdict
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, InputSignal, Problem, SolverSettings

DRIVE = """
model Drive
  parameter Real R(unit = "Ohm", min = 0) = 1;
  parameter Real K(unit = "N.m/A", min = 0) = 0.06;
  parameter Real J(unit = "kg.m2", min = 0) = 2e-4;
  parameter Real J_l(unit = "kg.m2", min = 0) = 5e-4;
  parameter Real c(unit = "N.m/rad", min = 0) = 20;
  parameter Real b(unit = "N.m.s/rad", min = 0) = 0.001;
  parameter Real F_c(unit = "N.m", min = 0) = 0.05;
  input Real u(unit = "V");
  output Real w(unit = "rad/s") = w_l;
  output Real i(unit = "A");
  Real w_m(unit = "rad/s", start = 0, fixed = true);
  Real w_l(unit = "rad/s", start = 0, fixed = true);
  Real phi(unit = "rad", start = 0, fixed = true);
equation
  u = R * i + K * w_m;
  J * der(w_m) = K * i - b * w_m - c * phi - 0.01 * (w_m - w_l);
  der(phi) = w_m - w_l;
  J_l * der(w_l) = c * phi + 0.01 * (w_m - w_l) - F_c * tanh(w_l / 0.1);
end Drive;
"""
TRUTH = {"R": 1.3, "K": 0.05, "J": 3e-4, "J_l": 6e-4, "c": 28.0, "b": 0.002, "F_c": 0.06}
FREE = ["R", "K", "J", "J_l", "c", "F_c"]
SETTINGS = FitSettings("local", calibration=CalibrationSettings(interpolation="hold", initial_states="reading"))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[aero_bayes.Model, Recording]:
    folder = tmp_path_factory.mktemp("drive")
    (folder / "Drive.mo").write_text(DRIVE)
    model = aero_bayes.load_model(Path(folder / "Drive.mo"))
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 4.0, 0.002)
    voltage = np.repeat(rng.uniform(-12.0, 12.0, 20), 100)
    experiment = Experiment(time, ("w", "i"), (InputSignal("u", time, voltage),))
    with open_simulator(Problem(model, (experiment,), ((),), TRUTH, SolverSettings(1e-8, 1e-8)), workers=0) as engine:
        speed, current = engine.simulate(np.zeros((1, 0))).outputs[0][0].T
    speed += 0.1 * rng.standard_normal(time.size)
    current += 0.05 * rng.standard_normal(time.size)
    return model, Recording("run", time, {"u": voltage}, {"w": speed, "i": current}, {"w": "rad/s", "i": "A"})


def test_without_the_current_no_torque_is_identified(drive: tuple[aero_bayes.Model, Recording]):
    model, whole = drive
    recording = Recording("run", whole.time, whole.inputs, {"w": whole.outputs["w"]}, whole.units)
    fit = aero_bayes.fit(recording, model, parameters=FREE, settings=SETTINGS, workers=0)
    (direction,) = fit.identifiability.flat
    assert {"R", "F_c", "J_l"} <= set(direction.members)
    assert abs(fit["R"].value - TRUTH["R"]) > 5.0 * (fit["R"].sd or 0.0)  # what a held guess does to it
    assert all(str(fit[name].status) == "weak" for name in direction.members)
    assert direction.sentence == fit.to_dict()["identifiability"]["text"][0]
    page = verdict(RunJson.model_validate({"identifiability": {"flat": [direction.sentence]}}))
    assert page.level == "warning"
    assert direction.sentence in page.text


def test_with_the_current_each_is(drive: tuple[aero_bayes.Model, Recording]):
    model, recording = drive
    settings = FitSettings("local", fixed={"b": TRUTH["b"]}, calibration=SETTINGS.calibration)
    fit = aero_bayes.fit(recording, model, parameters=FREE, settings=settings, workers=0)
    assert fit.identifiability.flat == ()
    for name in FREE:
        assert str(fit[name].status) == "identified"
        assert fit[name].value == pytest.approx(TRUTH[name], abs=5.0 * fit[name].sd)


@pytest.mark.parametrize(("level", "told"), [(1e8, True), (1e12, False)])
def test_a_common_change_that_no_value_moves_by_is_not_told(level: float, told: bool):
    """As of a chaotic system, whose readings tell each value to a thousandth."""
    information = level * np.array([[1.0, 1.0 - 1e-6], [1.0 - 1e-6, 1.0]])
    found = assess(["a", "b"], np.array([2.0, 3.0]), [True, False], information, np.array([1.0, 10.0]))
    assert bool(found.flat) == told
