"""Leaving blocks out to first order, against refits of a linear model without them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from aero_bayes.estimate.laplace import BLOCK_COUNT, LinearisedFit, blocks_of_time
from aero_bayes.estimate.noise import SampleTimes
from aero_bayes.estimate.objective import Series


def test_a_newton_step_is_the_refit_of_a_linear_model_without_the_block():
    rng = np.random.default_rng(1)
    slopes, prior = rng.normal(size=(4, 60)), np.diag([2.0, 1.0, 0.5, 1e-6])
    slopes[3, 10:] = 0.0  # only the first block determines the last parameter
    y = rng.normal(size=60)
    point = np.linalg.solve(slopes @ slopes.T + prior, slopes @ y)
    blocks = np.split(np.arange(60), 6)
    for left in LinearisedFit(slopes, y - point @ slopes, prior).without(blocks):
        rest = np.setdiff1d(np.arange(60), left.readings)
        curvature = slopes[:, rest] @ slopes[:, rest].T + prior
        refit = np.linalg.solve(curvature, slopes[:, rest] @ y[rest])
        assert point + left.step == pytest.approx(refit, rel=1e-7, abs=1e-7)


def test_blocks_hold_all_readings_once_and_no_fewer_than_asked_on_average():
    rng = np.random.default_rng(2)
    time = np.arange(300) * 0.1
    series = [Series(e, k, f"y{k}", SampleTimes.of(time, time), time) for e in range(2) for k in range(2)]
    linear = LinearisedFit(rng.normal(size=(3, 1200)), np.zeros(1200), np.eye(3))
    found = blocks_of_time(series, linear.leverage, BLOCK_COUNT, 50)
    assert [len(blocks) for blocks in found] == [12, 12]
    assert sorted(np.concatenate([c for blocks in found for c in blocks]).tolist()) == list(range(1200))
    for blocks in found:
        ends = [[np.tile(time, 4)[block].min(), np.tile(time, 4)[block].max()] for block in blocks]
        assert all(later[0] >= earlier[1] for earlier, later in pairwise(ends))
