"""What the speed report computes rather than times: pairs, the posterior."""

from __future__ import annotations

from contextlib import ExitStack

import bench_engine
import bench_sampling
import numpy as np
import pytest
from harness import Pair, time_pair

from aero_bayes.estimate.target import Target
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.model import Model

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


def test_pairs_have_the_keys_of_the_contract(tmp_path):
    model = Model.load(export_fmu("Aero.Systems.OneDof", tmp_path / "OneDof.fmu"))
    with ExitStack() as stack:
        found = {pair.key: pair for pair in bench_engine.pairs(model, tmp_path, stack)}
        assert set(found) == {"engine_over_fmpy_me", "two_cores_over_one", "sensitivities_over_plain"}
        assert found["engine_over_fmpy_me"].error < 1e-5
        assert np.shape(found["engine_over_fmpy_me"].first()) == (2001, 3)


def test_samplers_are_given_the_posterior_and_projected_by_evaluations(tmp_path):
    fit = bench_sampling.paper_fit(tmp_path)
    d = len(fit.free)
    with open_simulator(fit.calibration.problem(), workers=0) as simulator:
        value = bench_sampling.density(fit, Target(fit.calibration, simulator, fit.values, fit.free))
        at, away = value(np.stack([fit.laplace.mean[:d], fit.laplace.mean[:d] + 3.0 * fit.laplace.sd[:d]]))
        assert at > away
        assert value(np.full((1, d), 1e9))[0] == -np.inf
    own, other = bench_sampling.Sampled(2.0, 100, 50.0, 1.0), bench_sampling.Sampled(8.0, 1000, 20.0, 1.0)
    assert bench_sampling.compared("k", "n", own, other).ratio == pytest.approx(10.0)
    assert bench_sampling.compared("k", "n", own, other, 0.05).ratio == pytest.approx(0.05 * 1000 / 20.0 / 0.04)
    assert bench_sampling.compared("k", "n", own, bench_sampling.Sampled(8.0, 9, 0.0, np.nan)).ratio is None
