"""The noise filter against the dense normal density, and the noise estimate against known noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aero_bayes.sensors.noise import (
    BinnedPower,
    OutputNoise,
    Sampling,
    estimate_noise,
    log_likelihood,
    whiten,
)


def covariance(time, noise):
    apart = np.abs(time[:, None] - time[None, :])
    return noise.white**2 * np.eye(time.size) + noise.drift**2 * np.exp(-apart / noise.tau)


def draw(rng, n, interval, noise):
    phi = np.exp(-interval / noise.tau)
    x = np.empty(n)
    x[0] = rng.normal(0, noise.drift)
    for k in range(1, n):
        x[k] = phi * x[k - 1] + rng.normal(0, noise.drift * np.sqrt(1 - phi**2))
    return x + rng.normal(0, noise.white, n)


@pytest.mark.parametrize(
    "noise", [OutputNoise(0.3, 1.2, 0.4), OutputNoise(1.0, 0.2, 2.0), OutputNoise(0.01, 1.0, 0.05)]
)
@pytest.mark.parametrize("gaps", ["none", "block", "random", "uneven"])
def test_filter_is_the_dense_density(noise, gaps):
    rng = np.random.default_rng(3)
    time = np.arange(160) * 0.02
    values = rng.normal(size=160)
    if gaps == "block":
        values[40:70] = np.nan
    elif gaps == "random":
        values[rng.random(160) < 0.3] = np.nan
    elif gaps == "uneven":
        time = np.sort(rng.uniform(0, 3.2, 160))
    sampling = Sampling.of(time, values)
    seen = values[sampling.index]
    white, log_det = whiten(np.stack([seen, seen * 2.0 + 1.0]), sampling, noise)
    dense = covariance(time[sampling.index], noise)
    expected = multivariate_normal(np.zeros(seen.size), dense).logpdf(seen)
    assert log_likelihood(white[0], log_det) == pytest.approx(expected, rel=1e-5, abs=1e-3)
    factor = np.linalg.cholesky(dense)
    np.testing.assert_allclose(white[1], np.linalg.solve(factor, seen * 2.0 + 1.0), atol=2e-4)


def test_estimate_recovers_the_noise():
    rng = np.random.default_rng(11)
    truth = OutputNoise(1.0, 0.7, 0.8)
    time = np.arange(12000) * 0.01
    residual = draw(rng, time.size, 0.01, truth)
    found = estimate_noise([BinnedPower.of(residual, Sampling.of(time, residual))])
    assert found.white == pytest.approx(1.0, rel=0.04)
    assert found.drift == pytest.approx(0.7, rel=0.25)
    assert 0.4 < found.tau < 1.6


def test_estimate_on_white_noise_finds_hardly_any_drift():
    rng = np.random.default_rng(12)
    time = np.arange(6000) * 0.01
    residual = rng.normal(0, 2.0, time.size)
    sampling = Sampling.of(time, residual)
    found = estimate_noise([BinnedPower.of(residual, sampling)])
    white, log_det = whiten(residual[None], sampling, found)
    plain, plain_det = whiten(residual[None], sampling, OutputNoise(float(residual.std())))
    gain = log_likelihood(white[0], log_det) - log_likelihood(plain[0], plain_det)
    assert found.sd == pytest.approx(2.0, rel=0.05)
    assert -0.5 < gain < 10.0


def test_floor_holds():
    time = np.arange(1000) * 0.01
    residual = np.full(1000, 0.3)
    found = estimate_noise([BinnedPower.of(residual, Sampling.of(time, residual))], floor=0.5)
    assert found.white >= 0.5 * (1 - 1e-9)


def test_a_bad_start_does_not_matter():
    rng = np.random.default_rng(14)
    time = np.arange(6000) * 0.01
    residual = rng.normal(0, 2.0, time.size)
    power = BinnedPower.of(residual, Sampling.of(time, residual))
    found = estimate_noise([power], start=OutputNoise(1e-6, 2.0, 0.015))
    assert found.white == pytest.approx(2.0, rel=0.05)
