"""How sure a parameter is does not depend on how wide the range of another is."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, ParameterSpec, parameters_from_model
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.simulation.engines import open_simulator

pytestmark = pytest.mark.fast

LINE = """model Line "A level and a slope"
  parameter Real a = 1;
  parameter Real b = 0;
  input Real u;
  output Real y;
  Real s(start = 0, fixed = true);
equation
  der(s) = 0;
  y = a + 1e3*b*u + s;
end Line;
"""
NOISE = 0.1


def test_a_range_far_wider_leaves_the_intervals_of_least_squares(exported):
    model = exported(LINE)
    rng = np.random.default_rng(17)
    time = 0.1 * np.arange(400)
    u = np.repeat(rng.uniform(-1.0, 1.0, 100), 4)
    y = 1.2 + 0.9 * u + NOISE * rng.standard_normal(time.size)
    run = Recording("run", time, {"u": u}, {"y": y})
    wide = {"a": ParameterSpec(lower=0.0, upper=2.0), "b": ParameterSpec(lower=-1e6, upper=1e6)}
    free = parameters_from_model(model, overrides=wide)
    calibration = calibrate([run], model, free, settings=CalibrationSettings(may_start_at_rest=("s",)))
    with open_simulator(calibration.problem(), workers=0) as simulator:
        objective = Objective(calibration, simulator)
        start = calibration.parameters.to_search(calibration.parameters.start)
        found = local_fit(objective, start, (0, 1), settings=LocalFitSettings().least_squares(["y"]))
    rows = np.vstack([np.ones(u.size), u])
    (level, slope), *_ = np.linalg.lstsq(rows.T, y, rcond=None)
    left = y - np.array([level, slope]) @ rows
    exact = np.sqrt(np.diag(np.linalg.inv(rows @ rows.T)) * float(left @ left) / y.size)
    values = calibration.parameters.from_search(found.coordinates)
    scale = calibration.parameters.jacobian(values)
    assert values[:2] == pytest.approx([level, 1e-3 * slope], rel=1e-3)
    assert found.sd(0) * scale[0] == pytest.approx(exact[0], rel=0.02)
    assert found.sd(1) * scale[1] == pytest.approx(1e-3 * exact[1], rel=0.02)
