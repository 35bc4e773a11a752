"""A posterior of two modes: a chain in each, mixed by their probability, against the closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import arviz as az
import h5py
import numpy as np
import pytest

import aero_bayes
from aero_bayes.estimate.posterior import Posterior
from aero_bayes.estimate.swarm import SwarmSettings

GAIN, LAG, SD = 1.2, 2.0, 0.02
QUICK = aero_bayes.SampleSettings(ess=100.0, lengths=5.0, r_hat=1.05, max_rounds=2, draws=400, predictive=8)


@pytest.fixture(scope="module")
def posterior(tmp_path_factory: pytest.TempPathFactory) -> Posterior:
    """Of a gain that enters squared: both signs fit equally well."""
    path = tmp_path_factory.mktemp("squared") / "Squared.mo"
    path.write_text(
        """model Squared
  parameter Real b(min = -5, max = 5) = 0.7;
  parameter Real tau(unit = "s", min = 0.2, max = 20) = 1.5;
  input Real u;
  output Real y(start = 0, fixed = true);
equation
  tau * der(y) = b ^ 2 * u - y;
end Squared;
"""
    )
    time = np.linspace(0.0, 10.0, 101)
    noise = SD * np.random.default_rng(4).standard_normal(time.size)
    reading = GAIN**2 * (1.0 - np.exp(-time / LAG)) + noise
    recording = aero_bayes.Recording("step", time, {"u": np.ones(time.size)}, {"y": reading})
    settings = aero_bayes.FitSettings(pso=SwarmSettings(particles=10, iterations=10))
    found = aero_bayes.fit(
        recording, aero_bayes.load_model(path), parameters=["b", "tau"], settings=settings, workers=0
    )
    return aero_bayes.sample(found, settings=QUICK, workers=0)


def test_each_mode_has_the_draws_of_its_probability(posterior: Posterior) -> None:
    assert posterior.converged
    gain = posterior.samples("b")
    assert np.mean(gain > 0.0) == pytest.approx(0.5, abs=0.1)
    assert np.median(np.abs(gain)) == pytest.approx(GAIN, abs=5.0 * SD)
    assert np.std(np.abs(gain)) < SD
    told = posterior.to_dict()["mcmc"]["modes"]  # type: ignore[index]
    assert [row["values"]["b"] > 0.0 for row in told] == [
        np.median(gain[gain * row["values"]["b"] > 0.0]) > 0.0 for row in told
    ]
    assert sum(row["draws"] for row in told) == gain.size
    assert all(row["converged"] for row in told)


def test_every_ensemble_has_draws_of_both_modes(posterior: Posterior) -> None:
    column = posterior.names.index("b")
    for ensemble in posterior.draws[:, :, column]:
        first, last = np.array_split(ensemble > 0.0, 2)
        assert 0.3 < first.mean() < 0.7
        assert 0.3 < last.mean() < 0.7


def test_the_value_is_that_of_one_answer_and_the_interval_of_all(posterior: Posterior) -> None:
    entry = posterior["b"]
    assert abs(entry.value) == pytest.approx(GAIN, abs=5.0 * SD)
    assert entry.q05 == pytest.approx(-GAIN, abs=5.0 * SD)
    assert entry.q95 == pytest.approx(GAIN, abs=5.0 * SD)


def test_a_mode_whose_chain_is_short_is_not_called_converged(posterior: Posterior) -> None:
    short = aero_bayes.sample(posterior.fit, settings=replace(QUICK, max_rounds=1, max_steps=10), workers=0)
    assert not short.converged
    assert not any(row.converged for row in short.mode_draws)


def test_the_band_holds_its_share_of_the_readings_and_all_is_written(posterior: Posterior, tmp_path: Path) -> None:
    band, measured = posterior.predictive[0], posterior.calibration.data.measured[0]
    assert np.mean((measured > band.lower) & (measured < band.upper)) == pytest.approx(0.9, abs=0.08)
    path = posterior.save(tmp_path / "posterior.nc")
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]
    with h5py.File(path) as file:
        assert {"posterior", "log_likelihood", "posterior_predictive", "observed_data", "sample_stats"} <= set(file)
    np.testing.assert_allclose(az.from_netcdf(path)["posterior"]["b"].values.ravel(), posterior.samples("b"))
