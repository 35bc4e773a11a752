"""Whitening against dense algebra; estimates of noise, final and renewed between steps, against known noise; counts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cho_solve
from scipy.stats import multivariate_normal

from aero_bayes.estimate.noise import OutputNoise, SampleTimes
from aero_bayes.estimate.noise_estimation import (
    describe_sensors,
    estimate_noise,
    innovations,
    log_density,
    reading_log_density,
    rounding_error,
    thin_constant_readings,
    update_output_noise,
    whiten,
)

pytestmark = pytest.mark.fast

NOISES = [
    OutputNoise(0.7),
    OutputNoise(0.3, 1.2, 0.4),
    OutputNoise(1.0, 0.2, 2.0),
    OutputNoise(0.01, 1.0, 0.05),
    OutputNoise(0.2, 0.5, 1e-3),
]
TIMES = ["even", "block", "random", "dropped", "uneven"]


def covariance(time, noise):
    apart = np.abs(time[:, None] - time[None, :])
    slow = noise.sd_ou**2 * np.exp(-apart / noise.tau) if noise.sd_ou else 0.0
    return noise.sd_white**2 * np.eye(time.size) + slow


def sampled(kind):
    """Times and readings (160,), gaps NaN: two blocks, a third of all at random, every fortieth, uneven times."""
    rng = np.random.default_rng(3)
    time = np.arange(160) * 0.02
    values = rng.normal(size=160)
    if kind == "block":
        values[40:70] = np.nan
        values[100:103] = np.nan
    elif kind == "random":
        values[rng.random(160) < 0.3] = np.nan
    elif kind == "dropped":
        values[20::40] = np.nan
    elif kind == "uneven":
        time = np.sort(rng.uniform(0, 3.2, 160))
    return time, values


def draw(rng, n, interval, noise):
    phi = np.exp(-interval / noise.tau) if noise.sd_ou else 0.0
    x = np.empty(n)
    x[0] = rng.normal(0, noise.sd_ou)
    for k in range(1, n):
        x[k] = phi * x[k - 1] + rng.normal(0, noise.sd_ou * np.sqrt(1 - phi**2))
    return x + rng.normal(0, noise.sd_white, n)


@pytest.mark.parametrize("noise", NOISES, ids=str)
@pytest.mark.parametrize("kind", TIMES)
def test_products_density_and_innovations_are_those_of_the_dense_covariance(noise, kind):
    time, values = sampled(kind)
    sampling = SampleTimes.of(time, values)
    seen = values[sampling.index]
    rows = np.stack([seen, seen * 2.0 + 1.0, np.sin(3.0 * time[sampling.index]), np.ones(seen.size)])
    white, log_det = whiten(rows, sampling, noise)
    dense = covariance(time[sampling.index], noise)
    factor = np.linalg.cholesky(dense)
    np.testing.assert_allclose(white @ white.T, rows @ cho_solve((factor, True), rows.T), rtol=1e-9, atol=1e-8)
    assert log_det == pytest.approx(2.0 * np.sum(np.log(np.diag(factor))), rel=1e-10, abs=1e-8)
    expected = multivariate_normal(np.zeros(seen.size), dense).logpdf(seen)
    assert log_density(time, values, noise) == pytest.approx(expected, rel=1e-9, abs=1e-7)
    found = innovations(time, values, noise)
    np.testing.assert_allclose(found[sampling.index], np.linalg.solve(factor, seen), atol=1e-8)
    assert np.isnan(found[~np.isfinite(values)]).all()


def renewed(time, residual, **more):
    return update_output_noise([residual], [SampleTimes.of(time, residual)], longest=10.0, **more)


@pytest.mark.parametrize("start", [None, OutputNoise(1e-6, 2.0, 0.015)])
def test_white_noise_has_hardly_any_drift_wherever_the_search_begins(start):
    time = np.arange(6000) * 0.01
    residual = np.random.default_rng(12).normal(0, 2.0, time.size)
    found = renewed(time, residual, start=start)
    gain = log_density(time, residual, found) - log_density(time, residual, OutputNoise(float(residual.std())))
    assert found.sd == pytest.approx(2.0, rel=0.05)
    assert -0.5 < gain < 10.0


def test_floor_holds():
    time = np.arange(1000) * 0.01
    assert renewed(time, np.full(1000, 0.3), floor=0.5).sd_white >= 0.5 * (1 - 1e-9)


def test_noise_may_last_no_longer_than_it_is_allowed():
    """A slow sine has no correlation time below the limit; without one its own, seconds long, would be taken."""
    time = np.arange(3000) * 0.01
    residual = np.sin(0.8 * time) + 0.05 * np.random.default_rng(15).normal(size=3000)
    sampling = SampleTimes.of(time, residual)
    assert update_output_noise([residual], [sampling]).tau <= 0.02 * 30.0 * (1 + 1e-9)
    assert update_output_noise([residual], [sampling], longest=10.0).tau > 1.0


def test_densities_of_single_readings_are_those_of_the_dense_covariance():
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.uniform(0.01, 0.3, 60))
    residual = rng.standard_normal((3, 60))
    noise = np.array([[0.5, 0.8, 0.4], [0.9, 0.0, 0.0], [0.2, 1.5, 2.0]])
    unread = [7, 30, 31]
    residual[:, unread] = np.nan
    found = reading_log_density(time, residual, noise)
    assert np.all(found[:, unread] == 0.0)
    seen = np.isfinite(residual[0])
    for r, f, numbers in zip(residual, found, noise, strict=True):
        dense = covariance(time[seen], OutputNoise(*numbers))
        for n in (1, 7, 57):
            expected = multivariate_normal(np.zeros(n), dense[:n, :n]).logpdf(r[seen][:n])
            assert f[seen][:n].sum() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("truth", [OutputNoise(0.2), OutputNoise(0.1, 0.4, 0.3), OutputNoise(0.5, 0.4, 2.0)])
def test_known_noise_is_found_and_its_kind_too(truth: OutputNoise) -> None:
    rng = np.random.default_rng(7)
    t = np.arange(6000) * 0.01
    r = [draw(rng, t.size, 0.01, truth), draw(rng, t.size, 0.01, truth)]
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


def test_what_lasts_too_long_for_noise_keeps_its_size() -> None:
    """The limit is a fiftieth of the recording, here 0.6 s, for what is larger than the white noise."""
    time = np.arange(3000) * 0.01
    rng = np.random.default_rng(8)
    brief = estimate_noise([time], [draw(rng, time.size, 0.01, OutputNoise(0.01, 0.02, 0.15))])
    assert not brief.model_error
    assert brief.estimated == (True, True, True)
    small = estimate_noise([time], [draw(rng, time.size, 0.01, OutputNoise(0.05, 0.02, 1.2))])
    assert not small.model_error
    slow = draw(rng, time.size, 0.01, OutputNoise(0.01, 0.02, 1.2))
    smooth = 0.03 * np.sin(2.0 * time) + 0.01 * rng.standard_normal(time.size)
    for residual in (slow, smooth):
        found = estimate_noise([time], [residual])
        assert found.model_error
        assert found.kind == "white"
        assert found.sd == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-12)
        assert found.estimated == (False, False, False)


def test_rounding_of_a_slow_signal_lasts():
    time = np.arange(0.0, 20.0, 0.01)
    fast = rounding_error(time, 400.0 * np.sin(time) + 3.0 * time**1.5, 1.0)
    assert fast.sd == pytest.approx(1.0 / np.sqrt(12.0), rel=0.05)
    slow = rounding_error(time, 3.0 * np.sin(0.4 * time), 1.0)
    assert slow.kind == "ou"
    assert slow.rho(0.01) > 0.7


@pytest.mark.parametrize("size", [0.1, 1.5])
def test_what_rounding_adds_is_told(size):
    time = np.arange(0.0, 40.0, 0.01)
    signal = 30.0 * np.sin(0.7 * time)
    readings = np.round(signal + size * np.random.default_rng(9).standard_normal(time.size))
    found = describe_sensors(["y"], [(time, readings[:, None], signal[:, None])])["y"].encoder
    assert found.step == pytest.approx(1.0)
    assert found.share == pytest.approx(1 / 12 / (1 / 12 + size**2), rel=0.1)


def test_standstill_keeps_three_of_a_long_stretch():
    time = np.arange(1000) * 0.01
    values = np.concatenate([np.arange(300.0), np.full(400, 7.0), np.arange(300.0)])
    values[500] = np.nan
    use = thin_constant_readings(time, values)
    assert use[:300].all()
    assert use[700:].all()
    assert use[300:700].sum() == 3
    assert not use[500]
