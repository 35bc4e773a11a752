"""What the speed report computes rather than times: pairs, the posterior."""

from __future__ import annotations

import bench_sampling
import numpy as np
import pytest
from harness import Pair, time_pair

pytestmark = pytest.mark.long


def test_both_calls_of_a_pair_run_in_turn_and_the_ratio_is_that_of_one_unit(monkeypatch):
    now, calls = [0.0], []

    def takes(seconds: float) -> None:
        calls.append(seconds)
        now[0] += seconds

    monkeypatch.setattr("harness.time.perf_counter", lambda: now[0])
    row = time_pair(Pair("k", "n", lambda: takes(6.0), lambda: takes(4.0), (1, 2)), 2)
    assert calls == [6.0, 4.0] * 3
    assert (row.first_s, row.second_s, row.ratio) == (6.0, 2.0, 3.0)


def test_samplers_are_compared_and_projected_by_evaluations():
    own, other = bench_sampling.Sampled(2.0, 100, 50.0, 1.0), bench_sampling.Sampled(8.0, 1000, 20.0, 1.0)
    assert bench_sampling.compared("k", "n", own, other).ratio == pytest.approx(10.0)
    assert bench_sampling.compared("k", "n", own, other, 0.05).ratio == pytest.approx(0.05 * 1000 / 20.0 / 0.04)
    assert bench_sampling.compared("k", "n", own, bench_sampling.Sampled(8.0, 9, 0.0, np.nan)).ratio is None
