"""The O(n) covariance against dense algebra and a Kalman filter; estimates against known noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aero_bayes.estimate.noise import OutputNoise, SampleTimes
from aero_bayes.estimate.noise_estimation import estimate_noise, innovations, log_density, whiten

pytestmark = pytest.mark.fast


def dense(t: np.ndarray, n: OutputNoise) -> np.ndarray:
    k = n.sd_ou**2 * np.exp(-np.abs(t[:, None] - t) / n.tau) if n.sd_ou else 0.0
    return k + n.sd_white**2 * np.eye(t.size)


def draw(rng: np.random.Generator, t: np.ndarray, n: OutputNoise) -> np.ndarray:
    x = np.empty(t.size)
    z = rng.normal(size=t.size)
    x[0] = n.sd_ou * z[0]
    rho = np.exp(-np.diff(t) / n.tau) if n.sd_ou else np.zeros(t.size - 1)
    for k in range(1, t.size):
        x[k] = rho[k - 1] * x[k - 1] + n.sd_ou * np.sqrt(1 - rho[k - 1] ** 2) * z[k]
    return x + n.sd_white * rng.normal(size=t.size)


@pytest.mark.parametrize(
    "noise",
    [OutputNoise(0.3), OutputNoise(0.3, 0.8, 0.5), OutputNoise(0.01, 1.0, 30.0), OutputNoise(1.0, 0.01, 1e-3)],
)
def test_density_agrees_with_dense_algebra_on_irregular_times_with_gaps(noise: OutputNoise) -> None:
    rng = np.random.default_rng(6)
    t = np.sort(rng.uniform(0.0, 5.0, 60))
    r = draw(rng, t, noise)
    reference = multivariate_normal(np.zeros(60), dense(t, noise)).logpdf(r)
    assert log_density(t, r, noise) == pytest.approx(reference, rel=1e-8)
    white = innovations(t, r, noise)
    _, log_determinant = whiten(r[None], SampleTimes.of(t, r), noise)
    density = -0.5 * float(white @ white) - 0.5 * log_determinant - 30 * np.log(2 * np.pi)
    assert density == pytest.approx(reference, rel=1e-8)
    gaps = rng.random(60) < 0.3
    kept = ~gaps
    reference = multivariate_normal(np.zeros(kept.sum()), dense(t[kept], noise)).logpdf(r[kept])
    assert log_density(t, np.where(gaps, np.nan, r), noise) == pytest.approx(reference, rel=1e-8)
    columns = rng.normal(size=(60, 3))
    white, _ = whiten(columns.T, SampleTimes.of(t, r), noise)
    products = columns.T @ np.linalg.solve(dense(t, noise), columns)
    np.testing.assert_allclose(white @ white.T, products, rtol=1e-6, atol=1e-6 * np.max(np.diag(products)))


@pytest.mark.parametrize("truth", [OutputNoise(0.2), OutputNoise(0.1, 0.4, 0.3), OutputNoise(0.5, 0.4, 2.0)])
def test_known_noise_is_found_and_its_kind_too(truth: OutputNoise) -> None:
    rng = np.random.default_rng(7)
    t = np.arange(6000) * 0.01
    r = [draw(rng, t, truth), draw(rng, t, truth)]
    found = estimate_noise([t, t], r)
    assert found.kind == truth.kind
    assert found.sd_white == pytest.approx(truth.sd_white, rel=0.08)
    if truth.sd_ou:
        assert found.sd_ou == pytest.approx(truth.sd_ou, rel=0.35)
        assert found.tau == pytest.approx(truth.tau, rel=0.7)
        best = sum(log_density(t, x, found) for x in r)
        assert best >= sum(log_density(t, x, truth) for x in r)


def test_white_noise_is_rarely_taken_for_correlated() -> None:
    t = np.arange(800) * 0.05
    wrong = sum(estimate_noise([t], [np.random.default_rng(seed).normal(size=800)]).kind == "ou" for seed in range(40))
    assert wrong <= 3


def test_lag_one_correlation_of_the_sum() -> None:
    n = OutputNoise(0.3, 0.4, 2.0)
    k = dense(np.array([0.0, 0.1]), n)
    assert n.rho(0.1) == pytest.approx(k[0, 1] / k[0, 0])
    assert n.sd == pytest.approx(np.sqrt(k[0, 0]))


def test_what_lasts_too_long_for_noise_keeps_its_size() -> None:
    """The limit is a fiftieth of the recording, here 0.6 s, for what is larger than the white noise."""
    time = np.arange(3000) * 0.01
    rng = np.random.default_rng(8)
    brief = estimate_noise([time], [draw(rng, time, OutputNoise(0.01, 0.02, 0.15))])
    assert not brief.model_error
    assert brief.estimated == (True, True, True)
    small = estimate_noise([time], [draw(rng, time, OutputNoise(0.05, 0.02, 1.2))])
    assert not small.model_error
    slow = draw(rng, time, OutputNoise(0.01, 0.02, 1.2))
    smooth = 0.03 * np.sin(2.0 * time) + 0.01 * rng.standard_normal(time.size)
    for residual in (slow, smooth):
        found = estimate_noise([time], [residual])
        assert found.model_error
        assert found.kind == "white"
        assert found.sd == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-12)
        assert found.estimated == (False, False, False)
