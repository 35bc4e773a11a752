"""The proposed experiment keeps to its limits, tells what it says it tells, and the gain comes true in simulation."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from facts import facts

import simulated_rigs.aero as bench
from aero_bayes.errors import InputError
from aero_bayes.estimate import Limits
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.information import LEVELS, ExperimentPredictor, SearchSettings, posterior_sd, staircase
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.propose import propose_experiment
from simulated_rigs.designs import pulse

pytestmark = pytest.mark.fast

QUICK = SearchSettings(start=6, rounds=2, candidates=6, seed=3)
LOCAL = FitSettings(method="local")


@pytest.fixture(scope="module")
def short_pulse():
    truth = bench.Truth((), 0.006)
    return bench.simulate_recording(
        truth, pulse(6.0, 1.0, 3.0), bench.white(1.0), np.random.default_rng(1), duration=6.0, rate_hz=50.0
    )


@pytest.fixture(scope="module")
def fitted(one_dof, short_pulse):
    return fit(short_pulse, one_dof, settings=LOCAL, workers=0)


@pytest.fixture(scope="module")
def design(fitted):
    return propose_experiment(fitted, duration=15.0, targets=["D_p", "K_sp"], settings=QUICK, workers=0)


def test_signals_stay_within_one_and_take_few_levels():
    time = np.linspace(0.0, 20.0, 1001)
    for u in np.random.default_rng(2).random((50, 2 * LEVELS)):
        values = staircase(u, time)
        assert np.all(np.abs(values) <= 1.0)
        assert np.unique(values).size == LEVELS


def test_information_is_that_of_finite_differences_and_a_dense_covariance(fitted):
    time = np.arange(0.0, 4.0, 0.05)
    volts = np.where(time < 2.0, 10.0, -4.0)
    noisy = replace(fitted.noise["theta"], sd_ou=0.004, tau=0.3)
    fitted = replace(fitted, optimum=replace(fitted.optimum, noise={**fitted.noise, "theta": noisy}))
    predictor = ExperimentPredictor(fitted, time, Limits(24.0, {"theta": 1.0}), workers=0)
    found = predictor.predict([volts])[0]
    count = len(predictor.shared)
    step, columns = 1e-4, []
    point = predictor.shared.to_search(predictor.values)
    rows = [np.append(predictor.values, predictor.delay_value + s * 1e-4) for s in (1, -1)]
    for j in range(count):
        for sign in (1, -1):
            moved = point + sign * step * np.eye(count)[j]
            rows.append(np.append(predictor.shared.from_search(moved), predictor.delay_value))
    with predictor.open([volts]) as simulator:
        outputs = simulator.simulate(np.array(rows)).outputs[0]
    columns = [(outputs[2 + 2 * j] - outputs[3 + 2 * j]) / (2.0 * step) for j in range(count)]
    columns.append((outputs[0] - outputs[1]) / 2e-4)
    joint = np.zeros((count + 1, count + 1))
    for k, name in enumerate(fitted.outputs):
        noise = fitted.noise[name]
        lag = np.abs(time[:, None] - time[None, :])
        slow = noise.sd_ou**2 * np.exp(-lag / noise.tau) if noise.sd_ou else 0.0
        covariance = slow + noise.sd_white**2 * np.eye(time.size)
        s = np.stack([c[:, k] for c in columns], axis=1)
        joint += s.T @ np.linalg.solve(covariance, s)
    joint[-1, -1] += 12.0 / 0.02**2
    marginal = np.linalg.inv(np.linalg.inv(joint)[:-1, :-1])
    sd = posterior_sd(found.information + predictor.precision())
    assert sd == pytest.approx(posterior_sd(marginal + predictor.precision()), rel=0.02)


def test_proposal_keeps_to_its_limits_and_beats_repetition(design):
    assert np.max(np.abs(design.values)) <= 24.0
    assert design.travel["theta"] <= 1.0
    assert design.targets == ("D_p", "K_sp")
    assert design.gain > 1.5
    aimed = [e for e in design.expected if e.target]
    assert np.mean([np.log(e.sd_repeated / e.sd_after) for e in aimed]) > 0.0
    assert all(e.sd_after <= e.sd_before for e in design.expected)


def test_less_travel_means_a_smaller_gain(fitted, design):
    tight = propose_experiment(
        fitted, duration=15.0, targets=["D_p", "K_sp"], settings=QUICK, workers=0,
        limits=Limits(24.0, {"theta": 0.05}),
    )  # fmt: skip
    assert tight.travel["theta"] <= 0.05
    assert 1.0 < tight.gain < design.gain


def test_proposal_follows_from_its_seed_and_reads_back(fitted, design, tmp_path: Path):
    again = propose_experiment(fitted, duration=15.0, targets=["D_p", "K_sp"], settings=QUICK, workers=0)
    assert np.array_equal(again.values, design.values)
    with design.write_csv(tmp_path / "next.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert np.allclose([float(r["V_m"]) for r in rows], design.values, atol=1e-4)
    assert np.allclose([float(r["time"]) for r in rows], design.time)
    assert design.to_dict()["parameters"]["D_p"]["gain"] == pytest.approx(design.expected[5].gain)


def test_mistakes_get_one_line(fitted):
    with pytest.raises(InputError, match=facts("nonsense")):
        propose_experiment(fitted, targets=["nonsense"], settings=QUICK, workers=0)
    with pytest.raises(InputError, match=facts("samples")):
        propose_experiment(fitted, duration=0.01, settings=QUICK, workers=0)
    with pytest.raises(InputError, match="has no such output"):
        propose_experiment(fitted, limits=Limits(24.0, {"yaw": 1.0}), settings=QUICK, workers=0)
    with pytest.raises(InputError, match="positive"):
        Limits(amplifier=-1.0)
