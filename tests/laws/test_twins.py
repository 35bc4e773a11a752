"""A law at once at all like places of a model, with the same parameters: two rooms, and the sensors in them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from aero_bayes import InputError
from aero_bayes.data import Recording
from aero_bayes.laws.law_places import CandidateFilter, LawPlaces
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Name

ROOMS = """model Rooms "Two heated rooms, each with a sensor"
  parameter Real C(unit = "J/K", min = 0) = 400;
  parameter Real G(unit = "W/K", min = 0) = 3;
  input Real P1(unit = "W");
  input Real P2(unit = "W");
  output Real T1(unit = "degC", start = 0, fixed = true);
  output Real T2(unit = "degC", start = 0, fixed = true);
equation
  C*der(T1) = P1 - G*T1;
  C*der(T2) = P2 - G*T2;
end Rooms;
"""
STEP, LAG, NOISE = 2.0, 25.0, 0.05


def rooms(name, seed):
    """Two rooms whose sensors lag behind by the same time, each sample exact."""
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.uniform(0.0, 100.0, (20, 2)), 15, axis=0)
    one = np.array([[-3.0 / 400.0, 0.0, 1.0 / 400.0], [1.0 / LAG, -1.0 / LAG, 0.0], [0.0, 0.0, 0.0]])
    move = expm(one * STEP)
    read = np.zeros((len(power), 2))
    for k in range(2):
        x = np.zeros(3)
        for i, p in enumerate(power[:, k]):
            x[2], read[i, k] = p, x[1]
            x = move @ x
    read += rng.normal(0.0, NOISE, read.shape)
    time = STEP * np.arange(len(power))
    return Recording(name, time, {"P1": power[:, 0], "P2": power[:, 1]}, {"T1": read[:, 0], "T2": read[:, 1]})


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "Rooms.mo"
    path.write_text(ROOMS)
    return path


def test_like_places_are_offered_together(source):
    places = LawPlaces("Rooms", (source,))
    ids = [c.id for c in places.candidates]
    assert "lag@output_T1+output_T2" in ids
    assert not any("+" in id_ and "P1" in id_ and "T1" in id_ for id_ in ids)
    assert not any(id_.startswith("curve") and "+" in id_ for id_ in ids)
    narrow = LawPlaces("Rooms", (source,), candidate_filter=CandidateFilter(exclude=("output_T2",)))
    assert not any("T2" in c.port.id for c in narrow.allowed(narrow.candidates) if c.law.id == "lag")
    with pytest.raises(InputError, match="unknown effect"):
        LawPlaces("Rooms", (source,), candidate_filter=CandidateFilter(effects=("lag@T1+P1",))).check()


def test_one_lag_of_two_sensors_is_found_and_written_with_one_parameter(source, tmp_path):
    settings = LoopSettings(
        max_effects=2, parameters=("C", "G"), laws=("lag", "gain", "offset", "linear_loss"), cache=tmp_path / "fmu"
    )
    result = close_loop([rooms("a", 1)], [rooms("b", 2)], model=source, settings=settings, workers=0)
    (effect,) = result.effects
    assert effect.id == "lag@output_T1+output_T2"
    (lag,) = effect.parameters
    assert abs(lag.value - LAG) < 5.0 * lag.sd
    assert lag.sd < 0.05 * LAG
    assert all(error < 1.1 * NOISE for error in result.predicted_after.pooled("test").values())
    # one parameter sets both laws of the written model
    written = tmp_path / f"{result.model}.mo"
    written.write_text(result.modelica, encoding="utf-8")
    flat = load_flat(result.model, (written,))
    both = [v for v in flat.variables if v.name.startswith("lag") and v.name.endswith(f".{lag.name}")]
    assert [v.binding for v in both] == [Name(lag.name)] * 2
