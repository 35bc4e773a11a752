"""A delay of a recorded input as a term: the input is moved, exactly, and the model gets no equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, ParameterSpec, parameters_from_model
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import DelayTarget

SOURCE = """model Plate "A plate on a heater"
  input Real P(unit = "W");
  output Real T(unit = "K", start = 0, fixed = true);
  parameter Real C(unit = "J/K", min = 1, max = 1000) = 50;
  parameter Real G(unit = "W/K", min = 0.01, max = 10) = 0.7;
equation
  C * der(T) = P - G * T;
end Plate;
"""
C, G, DELAY, NOISE = 60.0, 0.6, 7.3, 0.05
TIME = np.arange(400.0)


def plate(delay: float) -> tuple[np.ndarray, np.ndarray]:
    """Power and temperature, exact from jump to jump."""
    power = np.repeat(np.random.default_rng(3).uniform(0.0, 20.0, 20), 20)
    jumps = np.unique(np.concatenate([TIME, TIME + delay]))
    level = np.zeros(jumps.size)
    for k in range(jumps.size - 1):
        late = max(np.searchsorted(TIME, jumps[k] - delay + 1e-9, side="right") - 1, 0)
        level[k + 1] = power[late] / G + (level[k] - power[late] / G) * np.exp(-(jumps[k + 1] - jumps[k]) * G / C)
    return power, level[np.searchsorted(jumps, TIME)]


@pytest.fixture(scope="module")
def family(tmp_path_factory) -> ModelicaFamily:
    folder = tmp_path_factory.mktemp("plate")
    (folder / "Plate.mo").write_text(SOURCE, encoding="utf-8")
    return ModelicaFamily(LawPlaces("Plate", (folder / "Plate.mo",)), folder)


def test_a_delay_of_a_recorded_input_moves_it_and_is_written_as_a_law(family, tmp_path):
    power, exact = plate(DELAY)
    read = exact + NOISE * np.random.default_rng(4).standard_normal(TIME.size)
    plain = family.base_model()
    free = parameters_from_model(plain, overrides={"C": ParameterSpec(), "G": ParameterSpec()})
    base = calibrate(
        [Recording("run", TIME, {"P": power}, {"T": read})], plain, free, settings=CalibrationSettings(delay="none")
    )
    own = range(len(base.parameters))
    with open_simulator(base.problem()) as simulator:
        start = base.parameters.to_search(base.parameters.start)
        fit = local_fit(Objective(base, simulator), start, own, settings=LocalFitSettings())
    assert {"delay@P", "lag@P", "delay@output_T"} <= set(family.prepare(base, fit, open_simulator))

    offer = family.with_candidates(["delay@P"])
    assert offer.model.sha256 == plain.sha256
    ((_, (delay,)),) = offer.terms
    assert delay.target == DelayTarget("P")
    beside = family.with_candidates(["delay@P", "lag@P"])
    assert len(beside.model.states) == len(plain.states) + 1
    solved = family.with_candidates(["delay@output_T"])
    assert len(solved.model.states) == len(plain.states) + 4

    written = family.extend(["delay@P"], {delay.name: DELAY}, tmp_path)
    assert "Delay delay(T_d = T_d, u = P)" in written.text
    assert len(written.model.states) == len(plain.states)
    (parameter,) = written.parameters
    longer = ParameterSet((*base.parameters, replace(parameter, start=5.0)))
    whole = replace(base, model=written.model, parameters=longer)
    with open_simulator(whole.problem()) as simulator:
        objective = Objective(whole, simulator)
        truth = [{"C": C, "G": G, parameter.name: DELAY}.get(p.name, 0.0) for p in whole.parameters]
        found = simulator.simulate(np.array([truth])).outputs[0][0, :, 0]
        np.testing.assert_allclose(found, exact, atol=1e-6 * np.ptp(exact))
        start = whole.parameters.to_search(whole.parameters.start)
        end = local_fit(objective, start, range(len(whole.parameters)), settings=LocalFitSettings())
    values = whole.parameters.from_search(end.coordinates)
    assert values[-1] == pytest.approx(DELAY, abs=5.0 * end.sd(len(values) - 1) * parameter.upper)
