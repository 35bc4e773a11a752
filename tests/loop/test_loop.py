"""The whole loop on recordings of the simulated bench: a small fixed part of the blind trial."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from facts import facts

from aero_bayes.data import Recording
from aero_bayes.data.split import Recordings
from aero_bayes.errors import InputError
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.loop.decide import decide
from aero_bayes.loop.first_fit import LoopContext, LoopStatistics, first_fit
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.loop.table import Table
from aero_bayes.simulation.workers import WorkerPool
from simulated_rigs.aero import Truth, pivot_friction, scaled, simulate_recording
from simulated_rigs.designs import random_levels
from simulated_rigs.sensors import real, white

SETTINGS = LoopSettings(max_effects=2)
close_aero = partial(close_loop, model="Aero.Systems.OneDof")


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    return tmp_path_factory.mktemp("loop-fmus")


def recordings(seed, sensors, delay, *effects, duration=30.0):
    rng = np.random.default_rng(seed)
    truth = Truth(effects, delay, scaled(R_a=1.08, k_t=0.93, D_p=1.1))
    return [
        simulate_recording(truth, random_levels(rng, 20.0, duration), sensors, stream, duration=duration, name=name)
        for name, stream in zip(("train", "test"), rng.spawn(2), strict=True)
    ]


def test_a_search_whose_time_is_up_is_judged_by_what_it_has_and_says_so(fmus):
    train, test = recordings(11, white(1.0), 0.0, pivot_friction(8e-4))
    found = close_aero([train], [test], settings=replace(SETTINGS, cache=fmus, max_minutes=1e-6), workers=0)
    assert found.outcome == "unexplained", (found.outcome, found.sentence)
    assert "1e-06 min" in found.sentence


def test_nothing_is_named_under_real_noise_and_the_end_is_held_out(fmus, tmp_path):
    train, _ = recordings(12, real(1.0), 0.006)
    found = close_aero([train], settings=replace(SETTINGS, cache=fmus), workers=0, out_dir=tmp_path)
    assert found.outcome == "adequate"
    assert found.effects == ()
    assert set(found.predicted_before.test) == {("train", output) for output in ("i_m", "omega_m", "theta")}
    assert "No missing effect was found" in found.sentence
    assert not list(tmp_path.glob("*.mo"))
    assert decide(Table.of(json.loads((tmp_path / "structures.json").read_text()))).model == ()


def test_bad_requests_are_refused(fmus):
    with pytest.raises(InputError, match="at least one"):
        close_aero([])
    train, _ = recordings(14, white(1.0), 0.0, duration=6.0)
    with pytest.raises(InputError, match=facts("held_out", "0")):
        close_aero([train], settings=LoopSettings(held_out=0.0, cache=fmus))
    with pytest.raises(InputError, match="unknown effect 'magic'"):
        close_aero([train], settings=LoopSettings(effects=("magic",), cache=fmus))
    with pytest.raises(InputError, match="no law is left to try"):
        close_aero([train], settings=LoopSettings(effects=("current_offset",), ports=("body",), cache=fmus))


CART = """model Cart
  parameter Real d(unit = "N.s/m") = 0.5;
  input Real F(unit = "N");
  output Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(v) = F - d * v;
end Cart;
"""


def test_a_model_that_declares_nothing_free_is_taken_as_it_is_for_laws_only(tmp_path: Path) -> None:
    path = tmp_path / "Cart.mo"
    path.write_text(CART, encoding="utf-8")
    time, noise = np.arange(400) * 0.02, np.random.default_rng(3).normal(0.0, 1e-3, 400)
    exact = 2.0 * (1.0 - np.exp(-0.5 * time))
    run = Recording("run", time, {"F": np.ones(400)}, {"v": exact + 0.05 * np.sin(2.0 * time) + noise})
    context = LoopContext(
        ModelicaFamily(LawPlaces("Cart", (path,)), tmp_path / "fmus"), Recordings.of([run], [], 0.3, ["v"]),
        LoopSettings(), WorkerPool(0), tmp_path, LoopStatistics(),
    )  # fmt: skip
    base = first_fit(context)
    assert base.plain.parameters.names == ()
    (report,) = base.reports
    left = 0.05 * np.sin(2.0 * time[:280]) + noise[:280]
    np.testing.assert_allclose(report.rms, np.sqrt(np.mean(left**2)), rtol=0.1)
    with pytest.raises(InputError, match=r"no parameters to fit: name some of d by LoopSettings\(parameters="):
        close_loop([run], [], model=path, workers=0)
