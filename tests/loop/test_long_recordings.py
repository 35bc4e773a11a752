"""Very long recordings are searched on a beginning that tells as much, reading by reading, as the whole."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.estimate.noise import SampleTimes
from aero_bayes.estimate.objective import Series, Whitened
from aero_bayes.loop.first_fit import FIRST_ROWS, beginning_share
from aero_bayes.simulation.interface import Experiment, InputSignal

pytestmark = pytest.mark.fast


def share(slope, residual, rows, kept=1, left=None):
    """Of a recording of so many rows, of which every ``kept``-th is fitted; ``left`` is its residual, if not white."""
    time = np.arange(rows) * 0.01
    slope, residual = slope[::kept], residual[::kept]
    series = Series(0, 0, "y", SampleTimes.of(time[::kept], residual), residual)
    experiment = Experiment(time[::kept], ("y",), (InputSignal("u", time, np.cos(time), "linear"),))
    whitened = Whitened(residual, slope[np.newaxis], 0.0, len(residual))
    return beginning_share([experiment], [series], whitened, [residual if left is None else left])


def test_a_beginning_is_enough_where_all_goes_on_alike():
    rows = 8 * FIRST_ROWS
    wave = np.sin(np.arange(rows) * 1.0)
    assert share(wave, wave, rows) == 1.0 / 8.0
    assert share(wave, wave, rows, kept=8) == 1.0 / 8.0
    assert share(wave[: 2 * FIRST_ROWS], wave[: 2 * FIRST_ROWS], 2 * FIRST_ROWS) == 1.0


def test_what_shows_later_only_is_waited_for():
    rows = 8 * FIRST_ROWS
    wave = np.sin(np.arange(rows) * 1.0)
    later = np.where(np.arange(rows) > 0.6 * FIRST_ROWS, wave, 0.0)
    assert share(later, wave, rows) == 2.0 / 8.0
    assert share(wave, np.where(np.arange(rows) > 6 * FIRST_ROWS, wave, 0.0), rows) == 1.0


def test_what_drifts_is_searched_whole_where_few_readings_are_kept():
    """A random walk has a few independent readings, however many there are of it."""
    rows = 8 * FIRST_ROWS
    wave = np.sin(np.arange(rows) * 1.0)
    drift = np.cumsum(np.random.default_rng(3).normal(size=rows))
    assert share(wave, wave, rows, kept=8) == 1.0 / 8.0
    assert share(wave, wave, rows, kept=8, left=drift[::8]) == 1.0
