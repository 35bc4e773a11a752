"""Port signals, their evidence and moments against closed forms of the linear-Gaussian model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aero_bayes.physics.locate import (
    LinearResponse,
    find_moment,
    infer_signal,
    kernel,
    posterior_signal,
    rank_ports,
)


@pytest.fixture
def system():
    """A slow and a fast port that answer on 300 readings, with three nuisance parameters."""
    rng = np.random.default_rng(5)
    time = np.linspace(0.0, 30.0, 25)
    sample = np.linspace(0.0, 30.0, 300)
    hats = np.stack([np.interp(sample, time, row) for row in np.eye(25)])
    slow = np.stack([np.convolve(hat, np.exp(-sample / 3.0))[:300] * 0.1 for hat in hats])
    nuisance = 50.0 * np.stack([np.sin(0.7 * sample), sample / 30.0, np.ones(300)])
    return rng, time, hats, slow, nuisance


def test_evidence_is_the_ratio_of_dense_densities(system):
    rng, time, hats, _, nuisance = system
    residual = np.sin(time) @ hats + rng.normal(size=300)
    covariance = 0.7**2 * (kernel(time, 4.0) + 1e-8 * np.eye(time.size))
    base = np.eye(300) + nuisance.T @ nuisance
    expected = multivariate_normal(np.zeros(300), base + hats.T @ covariance @ hats).logpdf(residual)
    expected -= multivariate_normal(np.zeros(300), base).logpdf(residual)
    found = infer_signal("port", time, hats, LinearResponse(residual, nuisance), (4.0,), (0.7,))
    assert found.gain == pytest.approx(expected, abs=1e-4)


def test_posterior_signal_is_the_regression(system):
    rng, time, hats, _, _ = system
    residual = rng.normal(size=300)
    covariance = 0.7**2 * kernel(time, 4.0)
    gram, score = LinearResponse(residual, np.empty((0, 300))).project(hats)
    mean, sd = posterior_signal(gram, score, covariance)
    exact = np.linalg.inv(np.linalg.inv(covariance) + hats @ hats.T)
    np.testing.assert_allclose(mean, exact @ hats @ residual, atol=1e-7)
    np.testing.assert_allclose(sd, np.sqrt(np.diag(exact)), rtol=1e-5)


def test_true_port_wins_and_its_signal_is_recovered(system):
    rng, time, hats, slow, nuisance = system
    truth = 3.0 * np.sin(2 * np.pi * time / 9.0)
    residual = truth @ slow + 0.3 * nuisance[0] + rng.normal(size=300)
    linear = LinearResponse(residual, nuisance)
    signals = {
        name: infer_signal(name, time, rows, linear, (1.0, 2.0, 4.0, 8.0))
        for name, rows in (("slow", slow), ("fast", hats))
    }
    order, tied = rank_ports(signals)
    assert order[0] == "slow"
    assert signals["slow"].gain > 100.0
    inside = slice(2, -2)
    assert np.sqrt(np.mean((signals["slow"].values - truth)[inside] ** 2)) < 1.0
    assert "slow" in tied


def test_no_signal_gives_no_gain(system):
    rng, time, hats, slow, nuisance = system
    linear = LinearResponse(rng.normal(size=300) + 0.2 * nuisance[1], nuisance)
    for rows in (slow, hats):
        assert infer_signal("x", time, rows, linear, (1.0, 4.0)).gain < 6.0


def test_moment_is_found_in_its_place(system):
    rng, time, _, slow, nuisance = system
    residual = 6.0 * slow[10] + 6.0 * slow[11] + rng.normal(size=300)
    found = find_moment("body", time, slow, LinearResponse(residual, nuisance))
    assert found is not None
    assert found.start < time[10] < time[11] < found.stop
    assert found.stop - found.start < 5.0
    assert found.gain > 20.0
    quiet = find_moment("body", time, slow, LinearResponse(rng.normal(size=300), nuisance))
    assert quiet is not None
    assert quiet.gain < 3.0
