"""Very long recordings are searched on a beginning that tells as much, reading by reading, as the whole."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.estimate.noise import SampleTimes
from aero_bayes.estimate.objective import Series, Whitened
from aero_bayes.loop.first_fit import FIRST_ROWS, beginning_share

pytestmark = pytest.mark.fast


def share(slope, residual, rows):
    time = np.arange(rows) * 0.01
    series = Series(0, 0, "y", SampleTimes.of(time, residual), residual)
    return beginning_share([rows], [series], Whitened(residual, slope[np.newaxis], 0.0, rows))


def test_a_beginning_is_enough_where_all_goes_on_alike():
    rows = 8 * FIRST_ROWS
    wave = np.sin(np.arange(rows) * 0.1)
    assert share(wave, wave, rows) == 1.0 / 8.0
    assert share(wave[: 2 * FIRST_ROWS], wave[: 2 * FIRST_ROWS], 2 * FIRST_ROWS) == 1.0


def test_what_shows_later_only_is_waited_for():
    rows = 8 * FIRST_ROWS
    wave = np.sin(np.arange(rows) * 0.1)
    later = np.where(np.arange(rows) > 0.6 * FIRST_ROWS, wave, 0.0)
    assert share(later, wave, rows) == 2.0 / 8.0
    assert share(wave, np.where(np.arange(rows) > 6 * FIRST_ROWS, wave, 0.0), rows) == 1.0
