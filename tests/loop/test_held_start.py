"""A start that the model fixes where a law acts on it, and starts of the states of laws."""

from dataclasses import replace

import numpy as np
import pytest
from closed_form import held
from rigs import METER, RIGS, ROOM, noise

from aero_bayes import FitSettings, fit
from aero_bayes.data import Recording
from aero_bayes.estimate.initial_states import held_start
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.simulation.engines import open_simulator


def fitted_room(folder):
    """The room's models, with the fit for which laws were prepared."""
    (folder / "Room.mo").write_text(ROOM, encoding="utf-8")
    family = ModelicaFamily(LawPlaces("Room", (folder / "Room.mo",)), folder / "fmu")
    given = RIGS["room"].recordings()[:1]
    found = fit(given, family.base_model(), parameters=["C_a"], settings=FitSettings("local"), workers=0)
    family.prepare(found.calibration, found.optimum, open_simulator)
    return family


def test_a_start_is_that_of_its_state_where_a_law_acts_on_the_reading(tmp_path):
    family = fitted_room(tmp_path)
    base = family.base_model()
    air, wall = (held_start(base, s, 1.0, "", 0) for s in sorted(base.states, key=lambda s: s.name))
    lagging = family.with_candidates(["lag@output_T"]).model
    moved, same = family.starts_on([replace(air, starts=("T",)), wall], base, lagging)
    names = {state.name for state in lagging.states}
    assert {moved.target.state, *moved.starts, same.target.state} <= names
    assert moved.target.state == moved.starts[0] == "T_unread"
    assert same == wall


def test_the_written_model_has_the_fitted_values_and_the_start_in_its_difference(tmp_path):
    family = fitted_room(tmp_path)
    extended = family.extend(["lag@Q"], {}, tmp_path / "out")
    name = next(new for pairs in extended.names.values() for _, new in pairs if "start" not in new)
    written = extended.with_values({name: 125.0}, {"T_w": 2.0})
    added = [line for line in written.diff.splitlines() if line.startswith("+")]
    assert written.path.read_text(encoding="utf-8") == written.text
    assert any(f" {name}(" in line and "= 125.0 " in line for line in added)
    assert any("T_w(" in line and "start = 2.0" in line for line in added)


def late(name: str, seed: int, start: float) -> Recording:
    """Behind a filter of 0.4 s, which holds something else than the first input when a recording begins."""
    u = np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, 20), 20)

    def slope(x, level):
        return np.array([(level - x[0]) / 0.4, (1.5 * x[0] - x[1]) / 0.8])

    read = held(slope, np.array([start, 0.0]), u, 0.05, 8)[:, 1]
    return Recording(name, 0.05 * np.arange(u.size), {"u": u}, {"y": read + 0.003 * noise(seed, u.size)})


def test_the_start_of_a_laws_state_has_a_value_in_each_recording(tmp_path):
    (tmp_path / "Meter.mo").write_text(METER, encoding="utf-8")
    settings = LoopSettings(parameters=("T", "K"), laws=("lag", "gain", "offset"), max_effects=1)
    training = [late("a", 21, 2.0), late("b", 22, -1.5)]
    result = close_loop(training, [late("c", 23, 1.0)], model=tmp_path / "Meter.mo", settings=settings, workers=0)
    assert [effect.id for effect in result.effects] == ["lag@u"]
    (time,) = (p for p in result.effects[0].parameters if p.name == "T_l")
    # the two time constants in series may be exchanged
    assert time.value == pytest.approx(0.4, rel=0.05) or time.value == pytest.approx(0.8, rel=0.05)
    assert 'T_l(unit = "s"' in result.modelica
    written = float(result.modelica.partition("T_l(")[2].partition(") = ")[2].partition(" ")[0])
    assert written == pytest.approx(time.value, rel=1e-5)
