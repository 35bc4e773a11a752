"""A model that is compiled to be tried gives the numbers of the same model compiled to be used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.export.embedded import export_flat
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.simulation import Experiment, InputSignal, Model, NativeSimulator, ParameterTarget, Problem

pytestmark = pytest.mark.fast

#: Laws that are off at zero (F_c, c, g, b), slow functions that count times one of them, times none and twice.
SOURCE = """
model Laws
  input Real u;
  output Real y;
  parameter Real m = 1.3, k = 20.0, d = 0.4, F_c = 0.0, c = 0.0, v_s = 0.02, g = 0.0, b = 0.0;
  Real x(start = 0.1, fixed = true), v(start = 0.0, fixed = true), turn;
equation
  turn = tanh(v / 0.5);
  der(x) = v;
  m * der(v) = u - k * x - d * v - F_c * tanh(v / 0.01) - F_c * exp(-(v / v_s) ^ 2) * turn
    - (if x > 1.0 then c * sqrt(x + 2.0) else c * sin(x)) - g * log(2.0 + x) / cos(b * turn);
  y = x + 0.01 * turn;
end Laws;
"""
PARAMETERS = ("m", "k", "d", "F_c", "c", "v_s", "g", "b")


@pytest.fixture(scope="module")
def problems(tmp_path_factory: pytest.TempPathFactory) -> tuple[Problem, Problem]:
    folder: Path = tmp_path_factory.mktemp("laws")
    (folder / "Laws.mo").write_text(SOURCE)
    flat = load_flat("Laws", (folder / "Laws.mo",), ())
    time = np.linspace(0.0, 4.0, 401)
    force = InputSignal("u", np.array([0.0, 1.0, 2.5]), np.array([1.0, -2.0, 0.5]))
    experiment = Experiment(time, ("y",), (force,))
    used, tried = (Model.load(export_flat(flat, folder / f"{quick}.fmu", quick=quick)) for quick in (False, True))
    targets = (tuple(map(ParameterTarget, PARAMETERS)),)
    return Problem(used, (experiment,), targets), Problem(tried, (experiment,), targets)


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("on", [(), ("F_c",), ("c", "b"), ("F_c", "g", "b")])
def test_a_model_to_be_tried_gives_the_same_numbers(problems, here, on, interpolation) -> None:
    values = np.array([[1.3, 20.0, 0.4, 0.0, 0.0, 0.02, 0.0, 0.0]])
    for name in on:
        values[0, PARAMETERS.index(name)] = 0.3
    found = []
    for problem in problems:
        (experiment,) = problem.experiments
        signals = tuple(replace(s, interpolation=interpolation) for s in experiment.inputs)
        moved = replace(problem, experiments=(replace(experiment, inputs=signals),))
        with NativeSimulator(moved, pool=here) as simulator:
            runs = [simulator.simulate(values, active=columns) for columns in ([5, 1], range(len(PARAMETERS)), [0, 7])]
        found.append([(run.outputs[0], run.sensitivities[0]) for run in runs])
    for (y, slopes), (tried_y, tried_slopes) in zip(*found, strict=True):
        np.testing.assert_allclose(tried_y, y, rtol=1e-9, atol=1e-12)
        size = np.abs(slopes).max(axis=(0, 1, 2))
        assert np.all(np.abs(tried_slopes - slopes) <= 1e-8 * size + 1e-15)
