"""Very long recordings are searched on a beginning that tells as much, reading by reading, as the whole."""

from __future__ import annotations

import json

import numpy as np
import pytest
from closed_form import held

from aero_bayes.data import Recording
from aero_bayes.estimate.noise import SampleTimes
from aero_bayes.estimate.objective import Series, Whitened
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.loop.first_fit import FIRST_ROWS, beginning_share
from aero_bayes.simulation.interface import Experiment, InputSignal


def share(slope, residual, rows, kept=1, left=None):
    """Of a recording of so many rows, of which every ``kept``-th is fitted; ``left`` is its residual, if not white."""
    time = np.arange(rows) * 0.01
    slope, residual = slope[::kept], residual[::kept]
    series = Series(0, 0, "y", SampleTimes.of(time[::kept], residual), residual)
    experiment = Experiment(time[::kept], ("y",), (InputSignal("u", time, np.cos(time), "linear"),))
    whitened = Whitened(residual, slope[np.newaxis], 0.0, len(residual))
    return beginning_share([experiment], [series], whitened, [residual if left is None else left])


@pytest.mark.fast
def test_a_beginning_is_enough_where_all_goes_on_alike():
    rows = 8 * FIRST_ROWS
    wave = np.sin(np.arange(rows) * 1.0)
    assert share(wave, wave, rows) == 1.0 / 8.0
    assert share(wave, wave, rows, kept=8) == 1.0 / 8.0
    assert share(wave[: 2 * FIRST_ROWS], wave[: 2 * FIRST_ROWS], 2 * FIRST_ROWS) == 1.0


@pytest.mark.fast
def test_what_shows_later_only_is_waited_for():
    rows = 8 * FIRST_ROWS
    wave = np.sin(np.arange(rows) * 1.0)
    later = np.where(np.arange(rows) > 0.6 * FIRST_ROWS, wave, 0.0)
    assert share(later, wave, rows) == 2.0 / 8.0
    assert share(wave, np.where(np.arange(rows) > 6 * FIRST_ROWS, wave, 0.0), rows) == 1.0


@pytest.mark.fast
def test_what_drifts_is_searched_whole_where_few_readings_are_kept():
    """A random walk has a few independent readings, however many there are of it."""
    rows = 8 * FIRST_ROWS
    wave = np.sin(np.arange(rows) * 1.0)
    drift = np.cumsum(np.random.default_rng(3).normal(size=rows))
    assert share(wave, wave, rows, kept=8) == 1.0 / 8.0
    assert share(wave, wave, rows, kept=8, left=drift[::8]) == 1.0


OSCILLATOR = """model Oscillator
  parameter Real k(unit = "N/m", min = 0) = 30;
  parameter Real c(unit = "N.s/m", min = 0) = 1;
  input Real F(unit = "N");
  output Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  der(v) = F - k * x - c * v;
end Oscillator;
"""


def test_a_long_recording_is_searched_on_its_beginning(tmp_path):
    """A spring with a cubic part, in 12,000 rows, by a Runge-Kutta method of our own."""
    (tmp_path / "Oscillator.mo").write_text(OSCILLATOR, encoding="utf-8")
    rng, step, rows = np.random.default_rng(7), 0.02, 3 * FIRST_ROWS
    time, noise = step * np.arange(rows), 1e-4

    def shaken(name):
        waves = 2 * np.pi * np.arange(0.2, 2.0, 0.1)
        force = 1.5 * np.cos(waves[:, None] * time + rng.uniform(0, 2 * np.pi, waves.size)[:, None]).sum(axis=0)
        motion = held(
            lambda y, f: np.array([y[1], f - 40 * y[0] - 300 * y[0] ** 3 - y[1]]), np.zeros(2), force, step, 4
        )
        return Recording(name, time, {"F": force}, {"x": motion[:, 0] + noise * rng.normal(size=rows)})

    laws = ("cubic_stiffness", "linear_stiffness", "viscous_friction", "gain")
    settings = LoopSettings(max_effects=1, parameters=("k", "c"), laws=laws)
    result = close_loop(
        [shaken("a")], [shaken("b")], model=tmp_path / "Oscillator.mo", settings=settings, workers=0, out_dir=tmp_path
    )
    assert [effect.id for effect in result.effects] == ["cubic_stiffness@v"]
    assert result.effects[0].parameters[0].value == pytest.approx(300.0, rel=0.01)
    readings = json.loads((tmp_path / "structures.json").read_text(encoding="utf-8"))["readings"]
    assert readings == FIRST_ROWS / 2  # every second reading is kept, of a third of the rows
