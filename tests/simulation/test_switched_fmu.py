"""FMUs with Boolean, Integer and enumeration inputs against a closed form; libraries named by their package.mo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data.columns import Layout
from aero_bayes.data.read import read_recording
from aero_bayes.data.recording import to_experiment
from aero_bayes.modelica.sources import as_packages
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Problem
from aero_bayes.simulation.model import Model

CASE = Path(__file__).resolve().parents[3] / "shared" / "cases" / "72_discrete_inputs_fmu"


@pytest.mark.skipif(not CASE.exists(), reason="the FMU with discrete inputs is not on this machine")
def test_discrete_inputs_act_as_in_the_closed_form() -> None:
    model = Model.load(CASE / "cooler.fmu")
    inputs = ["heater.on", "heater.gear", "mode", "bus.T_amb"]
    layout = Layout.of(inputs, ["T"], model=model)
    found = read_recording(CASE / "words.csv", layout=layout).rows_where(np.arange(2400) < 400, "r")
    problem = Problem(model, (to_experiment(found),), ((),))
    with open_simulator(problem, workers=1) as simulator:
        ran = simulator.simulate(np.empty((1, 0))).outputs[0][0, :, 0]
    temperature, expected = 300.0, []
    for on, gear, mode in zip(*(found.inputs[name] for name in inputs[:3]), strict=True):
        expected.append(temperature)
        loss = 5.0 * (1.0 + (0.0, 0.5, 1.0)[int(mode) - 1])
        end = 295.0 + on * gear * 100.0 / loss
        temperature = end + (temperature - end) * np.exp(-loss * 5.0 / 1e4)
    np.testing.assert_allclose(ran, expected, atol=1e-2)


def test_a_package_file_stands_for_its_library(tmp_path: Path) -> None:
    parts = tmp_path / "Rigs" / "Parts"
    parts.mkdir(parents=True)
    (tmp_path / "Rigs" / "package.mo").write_text("package Rigs\nend Rigs;\n")
    (parts / "package.mo").write_text("within Rigs;\npackage Parts\nend Parts;\n")
    alone = tmp_path / "package.mo"
    alone.write_text("package Other\nend Other;\n")
    assert as_packages([parts / "package.mo", tmp_path / "Rigs" / "package.mo"]) == (tmp_path / "Rigs",)
    assert as_packages([alone, parts]) == (alone, parts)
